"""What a label run shows while it works."""

import sys
from typing import Protocol

import numpy as np

from hdsp.lattice import N_ABSTRACT_ACTIONS


class Labelled(Protocol):
    feasible: np.ndarray


class TaskProgress:
    """A bar with tasks per second, the share of infeasible tasks and the number of dropped maps; a context manager.

    Args:
        name: what is being labelled.
        total: number of maps.
        show: False shows messages, but no bar.
    """

    def __init__(self, name: str, total: int, show: bool = True):
        self._name, self._total, self._show = name, total * N_ABSTRACT_ACTIONS, show
        self._bar = None
        self._tasks = self._infeasible = self._dropped = 0

    def __enter__(self) -> "TaskProgress":
        return self

    def __exit__(self, *_) -> None:
        if self._bar is not None:
            self._bar.close()

    def say(self, *messages: str) -> None:
        """Lines on standard error."""
        for message in messages:
            print(f"{self._name}: {message}", file=sys.stderr)

    def begin(self, already_done: int = 0) -> None:
        """Shows the bar; ``already_done`` maps of the total need no work."""
        done = already_done * N_ABSTRACT_ACTIONS
        if not self._show or done == self._total:
            return
        from tqdm import tqdm

        # A log file gets a line now and then, a terminal a bar that moves.
        interval = 0.2 if sys.stderr.isatty() else 10.0
        self._bar = tqdm(
            desc=self._name, total=self._total, initial=done, unit="task", mininterval=interval, dynamic_ncols=True
        )

    def count(self, labels: Labelled | None) -> Labelled | None:
        """Counts the labels of one map (None = dropped), and returns them."""
        if labels is None:
            self._dropped += 1
        else:
            self._tasks += labels.feasible.size
            self._infeasible += int(labels.feasible.size - labels.feasible.sum())
        if self._bar is not None:
            share = self._infeasible / max(self._tasks, 1)
            self._bar.set_postfix_str(f"{share:.0%} infeasible, {self._dropped} maps dropped", refresh=False)
            self._bar.update(N_ABSTRACT_ACTIONS)
        return labels
