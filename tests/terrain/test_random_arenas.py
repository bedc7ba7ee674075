import numpy as np
import pytest
from scipy import ndimage

from hdsp.base.errors import InputError
from hdsp.terrain.random_arenas import ArenaSettings, random_arena


@pytest.fixture(scope="module", params=range(6))
def arena(request):
    return random_arena(request.param)


def test_it_has_the_asked_size_and_walls_all_around(arena):
    assert arena.shape == (200, 200) and arena.origin == (0.0, 0.0)
    border = np.ones(arena.shape, bool)
    border[4:-4, 4:-4] = False
    assert (arena.heights[border] >= 1.0).all()
    assert not np.isnan(arena.heights).any()


def test_a_robot_reaches_both_rooms_on_the_ground(arena):
    # A disc of 0.42 m around the base contains the robot at every heading.
    steep = ndimage.generic_filter(arena.heights, np.ptp, 3) > 0.05
    free = (ndimage.distance_transform_edt(~steep) >= 0.42 / 0.025) & (arena.heights < 0.1)
    pieces, _ = ndimage.label(free)
    largest = pieces == np.bincount(pieces[free]).argmax()
    assert largest[:80].sum() > 0.25 * 80 * 200
    assert largest[110:].sum() > 0.2 * 90 * 200


def test_it_holds_what_makes_it_worth_planning_in(arena):
    heights = arena.heights
    platform = (heights > 0.29) & (heights < 0.37)
    assert platform.sum() * 0.025**2 > 1.0, "a landing"
    assert ((heights > 0.14) & (heights < 0.19)).sum() * 0.025**2 > 0.3, "a step on the way to it"
    assert ((heights > 0) & (heights < 0.05)).any(), "low ground to drive over"
    inner = (heights[80:110] >= 1.0).any(axis=0)
    assert 40 <= (~inner).sum() <= 52, (
        "a door of 1.0 to 1.2 m in the wall between the rooms, less the cells at its sides"
    )


def test_an_arena_is_a_function_of_its_seed():
    np.testing.assert_array_equal(random_arena(3).heights, random_arena(3).heights)
    assert (random_arena(3).heights != random_arena(4).heights).any()
    assert random_arena(3, size=8.0).size == (8.0, 8.0)


def test_what_cannot_be_is_refused():
    with pytest.raises(InputError, match="side of at least 4"):
        random_arena(1, size=2.0)
    with pytest.raises(InputError, match="seed -3"):
        random_arena(-3)
    with pytest.raises(InputError, match="none of 200"):
        random_arena(1, settings=ArenaSettings(door_width=(0.3, 0.4)))
