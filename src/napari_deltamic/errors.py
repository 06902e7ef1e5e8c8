"""Errors and warnings that are meant to be read by a user."""


class InputError(ValueError):
    """Something the user gave cannot be used; the message says what and why, in one line.

    The command line prints it and exits with code 2; the widget shows it.
    """


class RepairWarning(UserWarning):
    """Input was usable only after a repair; the message says what was changed."""


class SlowPathWarning(UserWarning):
    """The compiled extension is missing; results are the same, but slower."""
