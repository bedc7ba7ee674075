"""The states of a search and its open list, compared with a dictionary and with sorting."""

import numpy as np

from hdsp.detailed.search import open_list, store
from hdsp.detailed.states import FEET_MASK, neutral_feet, pack_states

LOWEST = -12


def states(n):
    """Packed states at few poses, most with feet off neutral, some twice; int64 [n]."""
    rng = np.random.default_rng(0)
    feet = rng.integers(LOWEST, -LOWEST, (n, 4)) * (rng.random(n) < 0.9)[:, None]
    return pack_states(np.hstack((rng.integers(0, (9, 6, 1), (n, 3)), feet // 3)), LOWEST)


def test_a_store_finds_every_state_at_its_node_also_after_growth():
    seen = store.new_store((9, 20), neutral_feet(LOWEST))
    sizes, twin = [len(seen.node)], {}
    for cost, key in enumerate(states(20_000)):
        if not store.has_room(seen):
            more, before = store.growth_nbytes(seen), seen
            seen = store.grown(seen)
            kept = {id(array) for array in before}
            assert sum(a.nbytes for a in seen if id(a) not in kept and getattr(a, "base", a) is None) == more
            sizes.append(seen.node_bits)
        node = store.node_of(seen, key)
        assert (seen.g[node] == np.inf) == (key not in twin)
        assert twin.setdefault(key, (node, cost))[0] == node
        if seen.g[node] == np.inf:
            seen.g[node], seen.action[node] = cost, cost % 256
            seen.flags[node] |= cost % 4
    assert len(sizes) > 8 and len({*sizes[1:]}) > 1  # nodes outgrow their bits in a slot
    assert len(twin) < 20_000
    for key, (node, cost) in twin.items():
        assert store.find(seen, key) == node and store.key_of(seen, node) == key
        assert (seen.g[node], seen.action[node], seen.flags[node] & 15) == (cost, cost % 256, cost % 4)
    elsewhere = [key + (9 << 42) for key in twin if key & FEET_MASK != seen.neutral]
    assert {store.find(seen, key) for key in elsewhere} == {-1}
    assert seen.nbytes() < 18 * len(twin)  # with the reserve for growth and half a block per pose


def test_a_long_heap_gives_its_entries_in_order_after_it_was_shortened(monkeypatch):
    monkeypatch.setattr(open_list, "_MOST_NEAR", 1000)
    entries, closed = open_list.new_open_list(), np.zeros(40_000, np.uint8)
    entries.least[:] = np.inf  # the state of a list that once was short: all entries enter the heap
    values = np.random.default_rng(1).random(30_000).astype(np.float32)
    shortened = 0
    for node, f in enumerate(values):
        if not open_list.list_has_room(entries):
            more, before = open_list.growth_nbytes(entries, closed, 160), entries
            entries = open_list.with_room(entries, closed, 160)
            assert more == sum(a.nbytes for a, b in zip(entries, before, strict=True) if len(a) > len(b))
            shortened += entries.counts[open_list.FAR] > 0
        open_list.push(entries, f, node)
    popped = []
    while open_list.first_f(entries, closed, 0) < np.inf:
        popped.append(open_list.pop(entries))
    assert shortened > 3
    np.testing.assert_array_equal(values[popped], np.sort(values))
    assert len({*popped}) == len(values)
