"""Errors that a user can act on: one line that says what is wrong, where, and what to do."""


class TautError(Exception):
    """Its text is printed as it is, without a traceback; the command then exits with `status`."""

    status = 1


class UnusableError(TautError):
    """A calibration that nothing should be driven with."""

    status = 3
