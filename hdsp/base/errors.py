"""Errors for people: one line that names the value that was wrong and what is allowed."""


class InputError(ValueError):
    """Raised for bad input: a missing or damaged file, a wrong shape, a value out of range.

    The message is a single line, ready to be printed to a user; entry points print it without a traceback.
    """


class RefinementError(Exception):
    """Raised when a plan cannot be carried out as a motion.

    Attributes:
        action: number of the first action of the plan that cannot be carried out; -1 for its start.
    """

    def __init__(self, action: int, words: str):
        super().__init__(words)
        self.action = action
