"""Description of a labelled split: counts, shares and costs by category, and reasons for dropped maps."""

from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.storage import Place
from hdsp.labels.counts import LabelCounts, add_up, counts_by_category
from hdsp.labels.run.splits import LabelRun
from hdsp.labels.shards import read_shards

#: Kinds of dropped maps: the part of the robot for which the middle of the map has no free place.
BODY, FEET, BOTH, OTHER = "body alone", "feet alone", "body and feet", "other"


def describe_labels(run: LabelRun, place: Place, explained_maps: int = 2000) -> dict[str, Any]:
    """Counts a labelled split, as a whole and by category; shards are read one by one.

    Args:
        run: the split, with everything on which its labels depend.
        place: index of its labels, or another folder or URL with its shards alone.
        explained_maps: map count to explain, from the start of the split. Dropped maps among them are made again
            to find the obstacle at their start: a body collision, or a foot without a foothold.

    Raises:
        InputError: if shards are missing or damaged, or were made with other settings or code.
    """
    counts, seen, labelled = [], set(), 0
    for shard in read_shards(place):
        if shard.attributes["labels_hash"] != run.labels_hash:
            raise InputError(f"{place}: labels of other settings or code than these; label the split again")
        labelled += int(shard.attributes["maps"])
        counts.append(counts_by_category(shard.tasks))
        seen |= set(zip(shard.tasks.category.tolist(), shard.tasks.index.tolist(), strict=True))
    if labelled != run.split.maps:
        raise InputError(f"{place}: labels of {labelled} of {run.split.maps} maps; label the split to its end")
    by_category = add_up(counts, run.split.categories)
    dropped = [n for n in range(min(explained_maps, run.split.maps)) if run.map_of(n)[:2] not in seen]
    reasons = {number: why_dropped(run, number) for number in dropped}
    described = {
        category: {
            "maps_before": run.split.maps_per_category,
            **_counts(found),
            "dropped_for": _shares([why for n, why in reasons.items() if run.map_of(n)[0] == category]),
        }
        for category, found in by_category.items()
    }
    return {
        "maps_before": run.split.maps,
        **_counts(sum(by_category.values(), LabelCounts())),
        "dropped_for": _shares(list(reasons.values())),
        "dropped_maps_looked_at": len(reasons),
        "categories": described,
    }


def why_dropped(run: LabelRun, number: int) -> str:
    """Reason why map ``number`` has no valid start state in its middle."""
    from hdsp.detailed.actions.state_costs import foot_row
    from hdsp.detailed.world.body import collides
    from hdsp.detailed.world.world import build_world, cell_index

    terrain, heading = run.terrain_of(number), run.map_of(number)[2]
    world = build_world(terrain, run.robot)
    middle = int(cell_index(world, terrain.shape[0] // 2, terrain.shape[1] // 2))
    body = collides(world, heading, middle)
    tables = world.tables
    footholds = [
        [world.standable[middle + tables.feet[foot_row(tables, heading, foot, o)]] for o in range(tables.n_offsets)]
        for foot in range(4)
    ]
    feet = not np.array(footholds).any(axis=1).all()
    return {(True, False): BODY, (False, True): FEET, (True, True): BOTH}.get((body, feet), OTHER)


def _counts(counts: LabelCounts) -> dict[str, Any]:
    return {"maps": counts.maps, **counts.summary()}


def _shares(reasons: list[str]) -> dict[str, float]:
    return {why: reasons.count(why) / len(reasons) for why in (BODY, FEET, BOTH, OTHER) if why in reasons}
