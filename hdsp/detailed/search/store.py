"""The states seen by a search: cost from the start, last action, flags.

The robot drives and turns on neutral feet only, so nearly all states are poses (ix, iy, heading). Poses lie in *tiles*,
8 x 8 cells at one heading, created at the first touch. The neighbours of a pose share a few cache lines, without
hashing or comparison. A hash table finds the few states with feet off neutral.

Both kinds live in blocks of 64 *nodes*, 6 bytes each (cost 4, action 1, flags 1). A tile adds 4 bytes to its block and
4 bytes in a directory over all map tiles. A state off neutral adds its packed form (8 bytes) and 4 bytes per slot in
the hash table. The store keeps no predecessors: a path is traced by undoing actions.
"""

from typing import Any, NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.actions.action import START, undo
from hdsp.detailed.actions.successors import MAX_SUCCESSORS
from hdsp.detailed.states import FEET_MASK, pack, unpack
from hdsp.robot.lattice import HEADINGS

#: Slots in ``Store.counts``.
SEEN, BLOCKS, KEYS, EXPANDED, GOALS_LEFT, CUT = range(6)

#: Bits in ``Store.flags``.
CLOSED = 1  # expanded at its present cost
GOAL = 2
VISITED = 4  # expanded in the present anytime round

BLOCK = 64  # nodes
TILE = 8  # cells per side
#: Upper limit for the blocks that one expansion can need.
SPARE_BLOCKS = 32
_GROWTH = 1.25


@by_reference
class Store(NamedTuple):
    """States seen by a search; ``grown`` exchanges the fixed arrays for larger ones.

    Block 0 stays empty and stands for all untouched tiles.
    """

    directory: np.ndarray  # int32 [64 * tiles along x * tiles along y], block per tile, 0 = none
    tiles_x: int
    tiles_y: int
    neutral: int  # feet bits for neutral feet
    g: np.ndarray  # float32 [64 * blocks], cost from the start, inf = not seen
    action: np.ndarray  # uint8 [64 * blocks], last action
    flags: np.ndarray  # uint8 [64 * blocks]
    origin: np.ndarray  # int32 [blocks], place in ``directory``, or -1 - n for the n-th block off neutral
    key: np.ndarray  # int64 [states off neutral], packed
    key_block: np.ndarray  # int32 [states off neutral / 64], block with their nodes
    slot: np.ndarray  # int32 [power of two], hash table: place in ``key``, -1 = free
    counts: np.ndarray  # int64 [6]; CUT: whether the cost limit kept a state out
    out_key: np.ndarray  # buffers for the successors of one state
    out_cost: np.ndarray
    out_action: np.ndarray

    def nbytes(self) -> int:
        """Total array size in bytes."""
        return sum(array.nbytes for array in self if isinstance(array, np.ndarray))


def new_store(shape: tuple[int, int], neutral: int, blocks: int = 128) -> Store:
    """Returns an empty store.

    Args:
        shape: map size (nx, ny) in cells.
        neutral: feet bits for neutral feet.
        blocks: initial room in blocks.
    """
    tiles_x, tiles_y = (-(-n // TILE) for n in shape)
    blocks = max(blocks, 2 * SPARE_BLOCKS)
    keys = 4 * BLOCK
    count = np.zeros(6, np.int64)
    count[BLOCKS] = 1
    store = Store(
        directory=np.zeros(HEADINGS * tiles_x * tiles_y, np.int32),
        tiles_x=tiles_x,
        tiles_y=tiles_y,
        neutral=neutral,
        g=np.empty(BLOCK * blocks, np.float32),
        action=np.empty(BLOCK * blocks, np.uint8),
        flags=np.empty(BLOCK * blocks, np.uint8),
        origin=np.empty(blocks, np.int32),
        key=np.empty(keys, np.int64),
        key_block=np.empty(keys // BLOCK, np.int32),
        slot=np.full(2 * keys, -1, np.int32),
        counts=count,
        out_key=np.empty(MAX_SUCCESSORS, np.int64),
        out_cost=np.empty(MAX_SUCCESSORS, np.float64),
        out_action=np.empty(MAX_SUCCESSORS, np.uint8),
    )
    store.g[:BLOCK], store.flags[:BLOCK] = np.inf, 0
    return store


def grown(store: Store) -> Store:
    """Returns the store with more room for the kind of states that ran short."""
    changed: dict[str, Any] = {}
    for name, length in _new_lengths(store).items():
        changed[name] = _longer(getattr(store, name), length)
        if name == "slot":
            changed[name][:] = -1
            _fill_slots(changed[name], store.key, store.counts[KEYS])
    return store._replace(**changed)


@njit(allocates=False, nogil=True)
def emptied(store):
    """Empties the store for another search, within the touched parts alone; goal marks vanish as well."""
    count = store.counts
    for block in range(1, count[BLOCKS]):
        if store.origin[block] >= 0:
            store.directory[store.origin[block]] = 0
    if count[KEYS] > 0:
        store.slot[:] = -1
    count[:] = 0
    count[BLOCKS] = 1


def growth_nbytes(store: Store) -> int:
    """Additional bytes during ``grown``."""
    return sum(length * getattr(store, name).itemsize for name, length in _new_lengths(store).items())


def _new_lengths(store: Store) -> dict[str, int]:
    """New lengths for arrays too short for the successors of one more state, by name."""
    lengths: dict[str, int] = {}
    if store.counts[BLOCKS] + SPARE_BLOCKS > len(store.origin):
        blocks = int(_GROWTH * len(store.origin)) + SPARE_BLOCKS
        lengths |= {"g": BLOCK * blocks, "action": BLOCK * blocks, "flags": BLOCK * blocks, "origin": blocks}
    if store.counts[KEYS] + MAX_SUCCESSORS > len(store.key):
        blocks = int(_GROWTH * len(store.key_block)) + 4
        lengths |= {"key": BLOCK * blocks, "key_block": blocks}
    if 4 * (store.counts[KEYS] + MAX_SUCCESSORS) > 3 * len(store.slot):
        lengths["slot"] = 2 * len(store.slot)
    return lengths


def _longer(array: np.ndarray, length: int) -> np.ndarray:
    longer = np.empty(length, array.dtype)
    longer[: len(array)] = array
    return longer


@njit(inline="always")
def has_room(store):
    """Whether the store has room for the successors of any state."""
    keys = store.counts[KEYS] + MAX_SUCCESSORS
    return (
        store.counts[BLOCKS] + SPARE_BLOCKS <= len(store.origin)
        and keys <= len(store.key)
        and 4 * keys <= 3 * len(store.slot)
    )


@njit(inline="always")
def node_of(store, key):
    """Node for a packed state; adds a new state."""
    if key & FEET_MASK == store.neutral:
        return _pose_node(store, key)
    return _other_node(store, key)


@njit(inline="always")
def _pose_node(store, key):
    tile = _tile(store, key)
    block = np.int64(store.directory[tile])
    if block == 0:
        block = _new_block(store, tile)
        store.directory[tile] = block
    return BLOCK * block + _cell(key)


@njit(inline="always")
def _other_node(store, key):
    mask = len(store.slot) - 1
    s = _hash(key, mask)
    at = np.int64(store.slot[s])
    while at >= 0 and store.key[at] != key:
        s = (s + 1) & mask
        at = np.int64(store.slot[s])
    if at < 0:
        at = store.counts[KEYS]
        store.counts[KEYS] += 1
        if at % BLOCK == 0:
            store.key_block[at // BLOCK] = _new_block(store, -1 - at // BLOCK)
        store.key[at] = key
        store.slot[s] = at
    return BLOCK * np.int64(store.key_block[at // BLOCK]) + at % BLOCK


@njit(inline="always")
def _new_block(store, where):
    block = store.counts[BLOCKS]
    store.counts[BLOCKS] += 1
    store.origin[block] = where
    for node in range(BLOCK * block, BLOCK * (block + 1)):
        store.g[node] = np.inf
        store.flags[node] = 0
    return block


@njit(inline="always")
def _tile(store, key):
    """Tile index in the directory for a pose."""
    ix, iy, heading, _, _, _, _ = unpack(key)
    return (heading * store.tiles_x + ix // TILE) * store.tiles_y + iy // TILE


@njit(inline="always")
def _cell(key):
    """Index in its tile for a pose."""
    ix, iy, _, _, _, _, _ = unpack(key)
    return ix % TILE * TILE + iy % TILE


@njit(inline="always")
def _hash(key, mask):
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return np.int64((mixed ^ (mixed >> np.uint64(32))) & np.uint64(mask))


@njit(nogil=True)
def _fill_slots(slot, keys, n):
    mask = len(slot) - 1
    for i in range(n):
        s = _hash(keys[i], mask)
        while slot[s] >= 0:
            s = (s + 1) & mask
        slot[s] = i


@njit(inline="always")
def key_of(store, node):
    """Packed state at a node."""
    block, cell = node // BLOCK, node % BLOCK
    tile = np.int64(store.origin[block])
    if tile < 0:
        return store.key[BLOCK * (-1 - tile) + cell]
    column, y = tile // store.tiles_y, tile % store.tiles_y
    heading, x = column // store.tiles_x, column % store.tiles_x
    return pack(x * TILE + cell // TILE, y * TILE + cell % TILE, heading, 0, 0, 0, 0) | store.neutral


@njit(allocates=False)
def find(store, key):
    """Node for a packed state, -1 if the store has none."""
    if key & FEET_MASK == store.neutral:
        block = np.int64(store.directory[_tile(store, key)])
        return BLOCK * block + _cell(key) if block > 0 else np.int64(-1)
    mask = len(store.slot) - 1
    s = _hash(key, mask)
    while store.slot[s] >= 0:
        at = np.int64(store.slot[s])
        if store.key[at] == key:
            return BLOCK * np.int64(store.key_block[at // BLOCK]) + at % BLOCK
        s = (s + 1) & mask
    return np.int64(-1)


@njit(inline="always")
def waits(store, node):
    """Whether a node waits: seen, but not expanded at its present cost."""
    return store.g[node] < np.inf and store.flags[node] & CLOSED == 0


@njit(allocates=False, nogil=True)
def count_waiting(store):
    """Number of waiting states."""
    n = 0
    for node in range(BLOCK, BLOCK * store.counts[BLOCKS]):
        n += waits(store, node)
    return n


@njit()
def trace(world, store, key):
    """Returns the path to a state that was seen.

    Returns:
        Packed states from the start to ``key``, int64 [n], and the actions between them, uint8 [n - 1].
    """
    t = world.tables
    n = 1
    at = key
    action = store.action[find(store, at)]
    while action != START:
        at = undo(at, action, t.move_dx, t.move_dy, t.shifts, t.arcs)
        action = store.action[find(store, at)]
        n += 1
    path, actions = np.empty(n, np.int64), np.empty(n - 1, np.uint8)
    at = key
    for i in range(n - 1, -1, -1):
        path[i] = at
        if i > 0:
            actions[i - 1] = store.action[find(store, at)]
            at = undo(at, actions[i - 1], t.move_dx, t.move_dy, t.shifts, t.arcs)
    return path, actions
