"""Card of an abstraction: front matter that the hub reads, use, metrics, and a picture of judged patches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from hdsp.base.notebook import png_of
from hdsp.learning.saved_abstraction import PICTURE, Provenance
from hdsp.robot.lattice import robot_frame_goals

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet

#: (patches, goals) -> feasibility, costs
Predict = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]

#: Kinds of random maps, and maps of each, among which the picture shows those with goals of both judgements.
_KINDS, _OF_EACH = ("cuboid_1", "staircase", "wall_1", "mixed_2"), 3


@dataclass(frozen=True)
class HubCard:
    """Contents of a card.

    Attributes:
        name: name of the folder or repository.
        architecture: architecture of the network.
        provenance: origin of the labels.
        metrics: flat metrics, ``KIND/SET``.
    """

    name: str
    architecture: str
    provenance: Provenance
    metrics: Mapping[str, float]

    def markdown(self, text: str | None = None, picture: bool = False) -> str:
        """Returns the card.

        Args:
            text: body below the front matter; None = a short one.
            picture: whether `PICTURE` lies beside the card.
        """
        header = yaml.safe_dump(self.front_matter(), sort_keys=False, allow_unicode=True)
        shown = f"\n![Goals that the network judges feasible and infeasible]({PICTURE})\n" if picture else ""
        return f"---\n{header}---\n\n{(text or self._short()).rstrip()}\n{shown}"

    def front_matter(self) -> dict[str, Any]:
        """Returns licence, tags and metrics in the hub's terms."""
        robot = self.provenance.robot
        tags = ["robotics", "motion-planning", "wheeled-legged-robots", "height-map", self.architecture]
        results = [
            {
                "task": {"type": "robotics", "name": "feasibility and cost of abstract actions"},
                "dataset": {"type": "hdsp-labels", "name": of_set},
                "metrics": [{"type": kind, "name": kind.replace("_", " "), "value": v} for kind, v in values.items()],
            }
            for of_set, values in self._by_set().items()
        ]
        return {
            "license": "bsd-3-clause",
            "library_name": "hdsp",
            "pipeline_tag": "robotics",
            "tags": [*tags, *([robot] if robot else [])],
            **({"model-index": [{"name": self.name, "results": results}]} if results else {}),
        }

    def _by_set(self) -> dict[str, dict[str, float]]:
        """Metrics of feasibility and costs, by set."""
        found: dict[str, dict[str, float]] = {}
        for name, value in self.metrics.items():
            kind, _, of_set = name.partition("/")
            if of_set and not kind.startswith("loss") and np.isfinite(value):
                found.setdefault(of_set, {})[kind] = round(float(value), 6)
        return found

    def _short(self) -> str:
        maps = self.provenance.notes.get("maps")
        learned = f" It learned from {maps:,} maps." if isinstance(maps, int) else ""
        rows = [
            f"| {of_set} | {values['feasibility_accuracy']:.2%} | {values['cost_error']:.4f} |"
            for of_set, values in self._by_set().items()
            if {"feasibility_accuracy", "cost_error"} <= set(values)
        ]
        table = ["", "| set | feasibility correct | cost error |", "|---|---|---|", *rows] if rows else []
        lines = [
            f"# {self.name}",
            "",
            f"A network of the architecture `{self.architecture}` for the robot "
            f"{self.provenance.robot or '(unknown)'}. It reads a height map around a hybrid driving-stepping robot "
            f"and judges the 22 abstract actions: is the action feasible, and how much does it cost?{learned}",
            "",
            "```python",
            "import hdsp",
            "",
            f'abstraction = hdsp.load_abstraction("USER/{self.name}")  # or the path of this folder',
            "feasible, cost = abstraction.predict(patches, goals)",
            "```",
            *table,
        ]
        return "\n".join(lines)


def judged_patches(predict: Predict) -> TaskSet:
    """Returns random maps with the judgements of ``LearnedAbstraction.predict`` in place of labels."""
    from hdsp.labels.tasks import REASON_UNKNOWN, TaskSet
    from hdsp.terrain.scenes import TerrainSettings, random_map

    maps = [(kind, index) for kind in _KINDS for index in range(_OF_EACH)]
    heights = np.array([random_map(5, kind, index, TerrainSettings()).heights for kind, index in maps])
    count = len(maps)
    goals = np.broadcast_to(robot_frame_goals(0).astype(np.float32), (count, *robot_frame_goals(0).shape))
    feasible, cost = predict(heights, goals)
    actions = goals.shape[:2]
    return TaskSet(
        heights=heights,
        goals=goals,
        feasible=feasible,
        cost=np.where(feasible, cost, 0),
        reason=np.full(actions, REASON_UNKNOWN),
        category=np.array([kind for kind, _ in maps]),
        index=np.array([index for _, index in maps]),
        seed=np.full(count, 5),
        heading=np.zeros(count),
        start=np.zeros((count, 7)),
        goal=np.zeros((*actions, 7)),
    )


def picture_of(predict: Predict) -> bytes | None:
    """Returns a picture of judged patches as PNG; None without the package for pictures."""
    return png_of(judged_patches(predict))
