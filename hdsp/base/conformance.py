"""Contracts with named rules, for checks of user implementations.

A checker calls an implementation with small inputs. The first broken rule ends the check with a ``ConformanceError``,
which names the rule and the offending value.
"""

from collections.abc import Mapping

import numpy as np


class ConformanceError(AssertionError):
    """Raised when an implementation breaks a contract rule.

    The error is an ``AssertionError`` instead of an ``InputError``, because the fault lies in code, and checkers run in
    tests. The message is a single line.

    Attributes:
        rule: name of the broken rule.
    """

    def __init__(self, contract: str, rule: str, sentence: str, found: str):
        super().__init__(contract, rule, sentence, found)
        self.rule = rule

    def __str__(self) -> str:
        contract, rule, sentence, found = self.args
        return f"{contract}, rule {rule}: {sentence}; found: {found}"


class Contract:
    """Rules of a contract, and the rules checked so far.

    Args:
        name: contract name, for messages.
        rules: one sentence per rule, by rule name.
    """

    def __init__(self, name: str, rules: Mapping[str, str]):
        self.name, self.rules = name, rules
        self._checked: dict[str, None] = {}

    @property
    def checked(self) -> tuple[str, ...]:
        """Names of the rules checked so far, in the order of their first check."""
        return tuple(self._checked)

    def require(self, rule: str, holds: object, found: str) -> None:
        """Requires a rule to hold, and notes its check.

        Args:
            rule: rule name.
            holds: whether the rule holds, as a truth value.
            found: offending value in words.

        Raises:
            ConformanceError: the rule does not hold.
        """
        self._checked[rule] = None
        if not holds:
            raise ConformanceError(self.name, rule, self.rules[rule], " ".join(found.split()))

    def require_equal(
        self, rule: str, found: np.ndarray, expected: np.ndarray, words: str, tolerance: float = 0.0
    ) -> None:
        """Requires two arrays to agree.

        Args:
            rule: rule name.
            found, expected: arrays with the same shape; NaN equals NaN, and inf equals inf alone.
            words: array name in the message.
            tolerance: largest difference between two finite values.

        Raises:
            ConformanceError: the arrays differ; the message names the first different element and both values.
        """
        self.require(rule, found.shape == expected.shape, f"{words}: shapes {found.shape} and {expected.shape}")
        same = (found == expected) | (np.isnan(found) & np.isnan(expected))
        if tolerance > 0:
            same |= np.isclose(found, expected, rtol=0.0, atol=tolerance)
        if not same.all():
            at = tuple(np.argwhere(~same)[0].tolist())
            self.require(rule, False, f"{words}: {found[at]} instead of {expected[at]} at {list(at)}")

    def require_error(self, rule: str, error: type[Exception], call, words: str) -> None:
        """Requires a call to raise an error.

        Args:
            rule: rule name.
            error: error type.
            call: function without arguments.
            words: call name in the message.

        Raises:
            ConformanceError: the call returns, or raises another error type.
        """
        try:
            call()
        except error:
            self.require(rule, True, "")
        except Exception as other:
            self.require(rule, False, f"{words} raises {type(other).__name__}: {other}")
        else:
            self.require(rule, False, f"{words} raises no error")
