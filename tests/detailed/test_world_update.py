"""An updated world equals the world built from the changed map, to the last bit; a part keeps its steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.detailed.motion.refinement import ban
from hdsp.detailed.world import world_update
from hdsp.detailed.world.body import look_at_body
from hdsp.detailed.world.part import Part, part_of_world
from hdsp.detailed.world.world import build_world, cell_index
from hdsp.detailed.world.world_update import influence, updated_world
from hdsp.robot.lattice import HEADINGS, Grid, heading_angle, metres
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap
from tests.detailed.instances import toy

ROBOTS = {"toy": toy(), "momaro": Robot.load("momaro")}


def rough(rng, shape):
    """Noise, blocks and unknown cells."""
    heights = rng.uniform(0, 0.03, shape).astype(np.float32)
    for _ in range(rng.integers(1, 5)):
        x, y = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        heights[x : x + rng.integers(1, 12), y : y + rng.integers(1, 12)] += rng.choice([0.08, 0.2, 0.5])
    heights[rng.random(shape) < rng.choice([0.0, 0.02])] = np.nan
    return heights


def assert_same(found, expected):
    for name in expected._fields:
        if name not in ("tables", "constants", "base", "level_ground"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    known = found.base > 0
    if known.any():
        anew = np.zeros_like(found.base)
        p, heading = np.flatnonzero(known) % len(found.standable), np.flatnonzero(known) // len(found.standable)
        for at, h in zip(p.tolist(), heading.tolist(), strict=True):
            look_at_body(expected, h, at)
        anew[known] = expected.base[known]
        np.testing.assert_array_equal(found.base, anew)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    robot=st.sampled_from(sorted(ROBOTS)),
    shape=st.tuples(st.integers(1, 70), st.integers(1, 70)),
    data=st.data(),
)
def test_an_updated_world_is_the_world_of_the_changed_map(seed, robot, shape, data):
    robot, rng = ROBOTS[robot], np.random.default_rng(seed)
    before = rough(rng, shape)
    after, other = before.copy(), rough(rng, shape)
    low = [data.draw(st.integers(0, size - 1)) for size in shape]
    size = data.draw(st.integers(0, 6)), data.draw(st.integers(0, 6))
    part = tuple(slice(at, at + length) for at, length in zip(low, size, strict=True))
    after[part] = other[part]
    changed = (before != after) & ~(np.isnan(before) & np.isnan(after))
    world = build_world(HeightMap(before), robot)
    for ix, iy, heading in zip(*(rng.integers(0, [[shape[0]], [shape[1]], [HEADINGS]], (3, 40))), strict=True):
        look_at_body(world, heading, cell_index(world, ix, iy))
    former = {name: getattr(world, name).copy() for name in world_update._MAPS}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_update, "LARGEST_SHARE", data.draw(st.sampled_from([0.5, 1.0])))
        updated = updated_world(world, HeightMap(after), robot, changed)
    for name, values in former.items():
        np.testing.assert_array_equal(getattr(world, name), values)
    assert_same(updated, build_world(HeightMap(after), robot))


def test_only_a_part_is_compiled_anew(monkeypatch):
    robot = ROBOTS["momaro"]
    before = rough(np.random.default_rng(0), (300, 240))
    after = before.copy()
    after[120:126, 100:140] = 1.0
    changed = np.zeros(before.shape, bool)
    changed[120:126, 100:140] = True
    world = build_world(HeightMap(before), robot)
    compiled = []
    monkeypatch.setattr(world_update, "build_world", lambda part, of: compiled.append(part) or build_world(part, of))
    updated = updated_world(world, HeightMap(after), robot, changed)
    (part,) = compiled
    reach = influence(robot)
    assert part.shape == (6 + 4 * reach, 40 + 4 * reach)
    assert_same(updated, build_world(HeightMap(after), robot))


def test_without_a_change_a_world_stays_as_it_is():
    terrain = HeightMap.flat((40, 40))
    world = build_world(terrain, ROBOTS["toy"])
    assert updated_world(world, terrain, ROBOTS["toy"], np.zeros((40, 40), bool)) is world


def test_a_part_has_the_banned_steps_of_its_feet_and_no_others():
    """The rows of the part are those of the same steps on a map of the part alone."""
    robot, terrain, rng = ROBOTS["toy"], HeightMap.flat((80, 70)), np.random.default_rng(0)
    world, grid = build_world(terrain, robot), Grid((0.0, 0.0), terrain.shape)
    part = Part((32, 27), (20, 15))
    cut, inner = part_of_world(world, robot, part), Grid(tuple(metres(np.array(part.first))), part.shape)
    whole, expected = world.banned, world.banned
    for foot, turn, *cell in rng.integers(0, [4, HEADINGS, *part.shape], (20, 4)):
        step = Action(ActionKind.STEP, FEET[foot], 0.1)
        state = np.array([*inner.center(cell), heading_angle(turn), 0.0, 0.025, -0.025, 0.0])
        whole, expected = ban(whole, world, grid, state, step), ban(expected, cut, inner, state, step)
    for far in ((0, 0), (79, 69), (40, 69)):
        whole = ban(whole, world, grid, np.array([*grid.center(far), 0.0, 0.0, 0.0, 0.0, 0.0]), step)
    np.testing.assert_array_equal(part_of_world(world._replace(banned=whole), robot, part).banned, expected)
