"""A model in the user's own MJCF: what MuJoCo has in XML, the whole of it as a callback, and what either leaves."""

from tautline.io.exporting.mjcf.folder import write

__all__ = ["write"]
