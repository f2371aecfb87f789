"""Recordings from other programs' files, and results for them."""
