"""Progress of a label run on the terminal."""

import sys

from hdsp.labels.counts import LabelCounts
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS


class TaskProgress:
    """A progress bar; a context manager.

    The bar shows tasks per second, time left, the share of infeasible tasks by reason, and the number of dropped maps.

    Args:
        name: name shown before the bar.
        total: map count.
        show: False shows messages, but no bar.
    """

    def __init__(self, name: str, total: int, show: bool = True):
        self._name, self._total, self._show = name, total * N_ABSTRACT_ACTIONS, show
        self._bar = None
        self.counts = LabelCounts()

    def __enter__(self) -> "TaskProgress":
        return self

    def __exit__(self, *_) -> None:
        if self._bar is not None:
            self._bar.close()

    def say(self, *messages: str) -> None:
        """Prints lines on standard error."""
        for message in messages:
            print(f"{self._name}: {message}", file=sys.stderr)

    def note(self, *messages: str) -> None:
        """As `say`, but only if there is a bar."""
        if self._show:
            self.say(*messages)

    def begin(self, already_done: int = 0) -> None:
        """Shows the bar; ``already_done`` maps need no work."""
        done = already_done * N_ABSTRACT_ACTIONS
        if not self._show or done == self._total:
            return
        from tqdm import tqdm

        # A terminal gets a moving bar, a log file an occasional line.
        interval = 0.2 if sys.stderr.isatty() else 10.0
        self._bar = tqdm(
            desc=self._name, total=self._total, initial=done, unit="task", mininterval=interval, dynamic_ncols=True
        )

    def count(self, counts: LabelCounts) -> None:
        """Adds the counts for newly labelled maps."""
        self.counts += counts
        if self._bar is None:
            return
        shares = {reason: share for reason, share in self.counts.shares().items() if reason != "solved"}
        infeasible = " + ".join(f"{share:.0%} {reason}" for reason, share in shares.items()) or "0%"
        self._bar.set_postfix_str(f"infeasible: {infeasible}; {self.counts.dropped} maps dropped", refresh=False)
        self._bar.update((counts.maps + counts.dropped) * N_ABSTRACT_ACTIONS)
