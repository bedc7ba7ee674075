"""Reasons for infeasible labels: the status is that of the label, and the map bears out each cause."""

import numpy as np
import pytest

from hdsp import HeightMap
from hdsp.detailed.causes import Kind
from hdsp.detailed.search.outcome import Status
from hdsp.labels import label_map, label_reasons
from hdsp.robot.robot import Robot
from tests.planning.cause_check import complaints

MOMARO = Robot.load("momaro")
X, Y = np.mgrid[:72, :72] - 36


def patch(where, height):
    return HeightMap(np.where(where, height, 0.0).astype(np.float32))


#: Ground, the status that must occur, and the kinds among the causes of its tasks.
PATCHES = {
    "flat": (patch(X > 100, 0.0), Status.SOLVED, set()),
    "wall ahead": (patch((X > 18) & (X < 22), 1.0), Status.INVALID_GOAL, {Kind.EDGE, Kind.BODY}),
    "unknown ring": (patch(abs(np.hypot(X, Y) - 27) < 3, np.nan), Status.INFEASIBLE, {Kind.UNKNOWN}),
    "wall under the robot": (patch(abs(X) < 3, 1.0), Status.INVALID_START, {Kind.BODY}),
    "between walls": (patch(abs(Y) > 15, 1.0), Status.INVALID_GOAL, {Kind.EDGE, Kind.BODY}),
    "stones between the feet": (patch((abs(Y) < 3) & (abs(X) < 9), 0.4), Status.INVALID_START, {Kind.BODY}),
}


@pytest.mark.parametrize("name", PATCHES)
def test_q2_each_infeasible_label_has_its_status_and_a_cause_that_is_there(name):
    terrain, status, kinds = PATCHES[name]
    reasons, tasks = label_reasons(terrain, MOMARO), label_map(terrain, MOMARO)
    assert len(reasons) == 22
    if tasks is None:
        assert {reason.status for reason in reasons} == {Status.INVALID_START}
    else:
        assert [reason.status for reason in reasons] == tasks.reason.tolist()
    found = [words for reason in reasons for cause in reason.causes for words in complaints(cause, terrain, MOMARO)]
    assert not found, found
    chosen = [reason for reason in reasons if reason.status == status]
    named = {cause.kind for reason in chosen for cause in reason.causes}
    assert chosen and kinds <= named, [reason.words for reason in reasons]
    for reason in reasons:
        decided = reason.status in (Status.INVALID_START, Status.INVALID_GOAL)
        assert bool(reason.causes) or (not decided and "\n" not in reason.words), reason


@pytest.mark.parametrize("seed", range(3))
def test_q2_on_random_patches_every_cause_is_there(seed):
    rng, statuses = np.random.default_rng(seed), set()
    for _ in range(3):
        heights = np.zeros((72, 72), np.float32)
        for _ in range(5):
            x, y = rng.integers(0, 72, 2)
            heights[x : x + rng.integers(2, 25), y : y + rng.integers(2, 25)] = rng.choice([np.nan, 0.15, 0.4, 1.0])
        heights[16:56, 22:50] = 0
        terrain = HeightMap(heights)
        for reason in label_reasons(terrain, MOMARO):
            statuses.add(reason.status)
            assert not [words for cause in reason.causes for words in complaints(cause, terrain, MOMARO)]
            if reason.status == Status.INFEASIBLE:
                assert reason.words.startswith("there is no way: ")
    assert len(statuses) > 1
