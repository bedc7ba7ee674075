"""Errors for people: one line that names the value that was wrong and what is allowed."""


class InputError(ValueError):
    """Raised for bad input: a missing or damaged file, a wrong shape, a value out of range.

    The message is a single line, ready to be printed to a user; entry points print it without a traceback.
    """
