"""User errors: one line that names the wrong value and the allowed values."""


class InputError(ValueError):
    """Raised for bad input: a missing or damaged file, a wrong shape, a value out of range.

    The message is a single line for the user; entry points print it without a traceback.
    """


class RefinementError(Exception):
    """Raised if a plan cannot be executed as a motion.

    Attributes:
        action: index of the plan's first impossible action; -1 for its start.
    """

    def __init__(self, action: int, words: str):
        super().__init__(words)
        self.action = action
