"""Cameras and the marker in their pictures."""
