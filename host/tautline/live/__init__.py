"""A board and a camera at work together."""
