"""Errors that a user can act on: one line that says what is wrong, where, and what to do."""


class TautError(Exception):
    """Its text is printed as it is, without a traceback; the command then exits 1."""
