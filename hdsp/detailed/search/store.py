"""The states seen by a search: cost from the start, last action, flags.

The robot drives and turns on neutral feet only, so many states are poses (ix, iy, heading). Poses lie in *tiles*, 8 x 8
cells at one heading, created at the first touch. The neighbours of a pose share a few cache lines, without hashing or
comparison. A hash table finds the states with feet off neutral.

Both kinds live in blocks of 64 *nodes*, 8 bytes each: cost 4, feet and flags 3, action 1. A single cache line thus
answers all questions about a state. A block off neutral holds states at one pose, so a node stores its feet alone. A
tile adds 8 bytes to its block and 4 bytes in a directory over all map tiles. A state off neutral adds 4 bytes per slot
in the hash table, at most three quarters full. The bits of a slot beside its node hold a part of the hash, which spares
most looks at nodes of other states. The store keeps no predecessors: a path is traced by undoing actions.
"""

from typing import Any, NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.actions.action import START, undo
from hdsp.detailed.actions.successors import MAX_SUCCESSORS
from hdsp.detailed.states import FEET_MASK, HEADING_SHIFT, pack, unpack
from hdsp.robot.lattice import HEADINGS

#: Slots in ``Store.counts``; ``POSES`` counts poses with states off neutral.
SEEN, BLOCKS, KEYS, EXPANDED, GOALS_LEFT, CUT, POSES = range(7)

#: Bits in ``Store.flags``; four in all, see also ``multi_kernel``.
CLOSED = 1  # expanded at its present cost
GOAL = 2
VISITED = 4  # expanded in the present anytime round

BLOCK = 64  # nodes
TILE = 8  # cells per side
#: Upper limit for the blocks that one expansion can need.
SPARE_BLOCKS = 32
_GROWTH = 1.25
#: A node's parts. Flags are the lower half of a byte and feet bits the rest of its word; numba's machines are
#: little-endian.
_NODE = np.dtype(
    {
        "names": ["g", "word", "action", "flags"],
        "formats": [np.float32, np.uint32, np.uint8, np.uint8],
        "offsets": [0, 4, 4, 5],
        "itemsize": 8,
    }
)
_FEET_SHIFT = 12  # in a node's word
_UNSEEN = int(np.array([(np.inf, 0, 0, 0)], _NODE).view(np.int64)[0])  # a node with infinite cost


@by_reference
class Store(NamedTuple):
    """States seen by a search; ``grown`` exchanges the fixed arrays for larger ones.

    Block 0 stays empty and stands for all untouched tiles.
    """

    directory: np.ndarray  # int32 [64 * tiles along x * tiles along y], block per tile, 0 = none
    tiles_x: int
    tiles_y: int
    neutral: int  # feet bits for neutral feet
    node: np.ndarray  # int64 [64 * blocks], all parts of a node
    g: np.ndarray  # float32 [64 * blocks], cost from the start, inf = not seen; a view, as the next three
    word: np.ndarray  # uint32, action, flags and, off neutral, feet bits
    action: np.ndarray  # uint8, last action
    flags: np.ndarray  # uint8, flags in the lower half
    origin: np.ndarray  # int64 [blocks], place in ``directory``, or -1 - packed pose for a block off neutral
    slot: np.ndarray  # uint32 [any length], hash table: part of the hash, then the node; 0 = free
    node_bits: int  # bits for the node in a slot
    pose_slot: np.ndarray  # int32 [power of two], hash table: next node for a state off neutral at a pose, 0 = free
    counts: np.ndarray  # int64 [7]; CUT: whether the cost limit kept a state out
    out_key: np.ndarray  # buffers for the successors of one state
    out_cost: np.ndarray
    out_action: np.ndarray
    out_ahead: np.ndarray  # int64, see ``look_ahead``

    def nbytes(self) -> int:
        """Total array size in bytes."""
        return sum(array.nbytes for array in self if isinstance(array, np.ndarray) and array.base is None)


def new_store(shape: tuple[int, int], neutral: int, blocks: int = 128) -> Store:
    """Returns an empty store.

    Args:
        shape: map size (nx, ny) in cells.
        neutral: feet bits for neutral feet.
        blocks: initial room in blocks.
    """
    tiles_x, tiles_y = (-(-n // TILE) for n in shape)
    blocks = max(blocks, 2 * SPARE_BLOCKS)
    count = np.zeros(7, np.int64)
    count[BLOCKS] = 1
    node = np.empty(BLOCK * blocks, np.int64)
    node[:BLOCK] = _UNSEEN
    return Store(
        directory=np.zeros(HEADINGS * tiles_x * tiles_y, np.int32),
        tiles_x=tiles_x,
        tiles_y=tiles_y,
        neutral=neutral,
        node=node,
        **_parts(node),
        origin=np.empty(blocks, np.int64),
        slot=np.zeros(8 * BLOCK, np.uint32),
        node_bits=len(node).bit_length(),
        pose_slot=np.zeros(4 * SPARE_BLOCKS, np.int32),
        counts=count,
        out_key=np.empty(MAX_SUCCESSORS, np.int64),
        out_cost=np.empty(MAX_SUCCESSORS, np.float64),
        out_action=np.empty(MAX_SUCCESSORS, np.uint8),
        out_ahead=np.empty(MAX_SUCCESSORS, np.int64),
    )


def _parts(node: np.ndarray) -> dict[str, np.ndarray]:
    """Views of all nodes' parts, by name."""
    return {name: node.view(_NODE)[name] for name in ("g", "word", "action", "flags")}


def grown(store: Store) -> Store:
    """Returns the store with more room for the kind of states that ran short."""
    changed: dict[str, Any] = {}
    lengths = _new_lengths(store)
    for name in ("node", "origin"):
        if name in lengths:
            changed[name] = _longer(getattr(store, name), lengths[name])
    if "node" in changed:
        changed |= _parts(changed["node"]) | {"node_bits": _node_bits(lengths, store)}
    if "slot" in lengths:
        changed["slot"] = np.zeros(lengths["slot"], np.uint32)
        _fill_slots(store, changed["slot"], changed.get("node_bits", store.node_bits))
    if "pose_slot" in lengths:
        changed["pose_slot"] = np.zeros(lengths["pose_slot"], np.int32)
        _fill_pose_slots(store, changed["pose_slot"])
    return store._replace(**changed)


def load_growth(store: Store) -> None:
    """Compiles or loads the kernels of ``grown``, which short searches do not need."""
    _fill_slots(store, np.zeros_like(store.slot), store.node_bits)
    _fill_pose_slots(store, np.zeros_like(store.pose_slot))


@njit(allocates=False, nogil=True)
def emptied(store):
    """Empties the store for another search, within the touched parts alone; goal marks vanish as well."""
    count = store.counts
    for block in range(1, count[BLOCKS]):
        if store.origin[block] >= 0:
            store.directory[store.origin[block]] = 0
    if count[KEYS] > 0:
        store.slot[:] = 0
        store.pose_slot[:] = 0
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
        lengths |= {"node": BLOCK * blocks, "origin": blocks}
    if 4 * (store.counts[KEYS] + MAX_SUCCESSORS) > 3 * len(store.slot):
        lengths["slot"] = int(_GROWTH * len(store.slot)) + 4 * MAX_SUCCESSORS
    elif _node_bits(lengths, store) > store.node_bits:
        lengths["slot"] = len(store.slot)
    if 2 * (store.counts[POSES] + SPARE_BLOCKS) > len(store.pose_slot):
        lengths["pose_slot"] = 2 * len(store.pose_slot)
    return lengths


def _node_bits(lengths: dict[str, int], store: Store) -> int:
    """Bits for a node in arrays with new lengths."""
    return lengths.get("node", len(store.node)).bit_length()


def _longer(array: np.ndarray, length: int) -> np.ndarray:
    longer = np.empty(length, array.dtype)
    longer[: len(array)] = array
    return longer


@njit(inline="always")
def has_room(store):
    """Whether the store has room for the successors of any state."""
    return (
        store.counts[BLOCKS] + SPARE_BLOCKS <= len(store.origin)
        and 4 * (store.counts[KEYS] + MAX_SUCCESSORS) <= 3 * len(store.slot)
        and 2 * (store.counts[POSES] + SPARE_BLOCKS) <= len(store.pose_slot)
    )


@njit(inline="always")
def look_ahead(store, n):
    """Loads the slots and nodes of ``n`` successors off neutral into the cache.

    No load waits for a comparison, so all are on their way from main memory at the same time. ``node_of`` alone would
    wait for each in turn.
    """
    hidden = (np.int64(1) << store.node_bits) - 1
    for k in range(n):
        store.out_ahead[k] = store.slot[_home(_hash(store.out_key[k]), len(store.slot))]
    for k in range(n):
        store.out_ahead[k] = store.node[store.out_ahead[k] & hidden]


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
    mixed = _hash(key)
    s, tag = _home(mixed, len(store.slot)), _tag(mixed, store.node_bits)
    entry = np.int64(store.slot[s])
    while entry != 0:
        if entry >> store.node_bits == tag:
            node = entry & ((np.int64(1) << store.node_bits) - 1)
            if _is_at(store, node, key):
                return node
        s = s + 1 if s + 1 < len(store.slot) else 0
        entry = np.int64(store.slot[s])
    node = _new_node(store, key)
    store.slot[s] = tag << store.node_bits | node
    return node


@njit(inline="always")
def _is_at(store, node, key):
    """Whether a node off neutral is that of a packed state."""
    return np.int64(store.word[node]) >> _FEET_SHIFT == key & FEET_MASK and store.origin[node // BLOCK] == -1 - (
        key >> HEADING_SHIFT
    )


@njit(allocates=False)
def _new_node(store, key):
    """Adds a node for a packed state off neutral to the last block at its pose, or to a new block."""
    pose = -1 - (key >> HEADING_SHIFT)
    s = _pose_place(store.origin, store.pose_slot, pose)
    node = np.int64(store.pose_slot[s])
    if node == 0:
        store.counts[POSES] += 1
    if node % BLOCK == 0:  # the block is full
        node = BLOCK * _new_block(store, pose)
    store.pose_slot[s] = node + 1
    store.counts[KEYS] += 1
    store.word[node] = (key & FEET_MASK) << _FEET_SHIFT
    return node


@njit(inline="always")
def _pose_place(origin, pose_slot, pose):
    """Place of a pose in ``pose_slot``, or the free place for it."""
    s = np.int64(_hash(pose) >> np.uint64(32)) & (len(pose_slot) - 1)
    while pose_slot[s] != 0 and origin[(pose_slot[s] - 1) // BLOCK] != pose:
        s = (s + 1) & (len(pose_slot) - 1)
    return s


@njit(inline="always")
def _new_block(store, where):
    block = store.counts[BLOCKS]
    store.counts[BLOCKS] += 1
    store.origin[block] = where
    store.node[BLOCK * block : BLOCK * (block + 1)] = _UNSEEN
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
def _hash(key):
    """64 well-mixed bits for a packed state."""
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)


@njit(inline="always")
def _home(mixed, length):
    """First place in a table for the upper half of a hash."""
    return np.int64(((mixed >> np.uint64(32)) * np.uint64(length)) >> np.uint64(32))


@njit(inline="always")
def _tag(mixed, node_bits):
    """Part of the lower half of a hash that fits into a slot beside a node."""
    return np.int64((mixed & np.uint64(0xFFFFFFFF)) >> np.uint64(node_bits))


@njit(nogil=True)
def _fill_slots(store, slot, node_bits):
    """Fills an empty hash table, whose nodes have so many bits, from the store's."""
    for i in range(len(store.slot)):
        node = np.int64(store.slot[i]) & ((np.int64(1) << store.node_bits) - 1)
        if node == 0:
            continue
        mixed = _hash(key_of(store, node))
        s = _home(mixed, len(slot))
        while slot[s] != 0:
            s = s + 1 if s + 1 < len(slot) else 0
        slot[s] = _tag(mixed, node_bits) << node_bits | node


@njit(nogil=True)
def _fill_pose_slots(store, pose_slot):
    """Fills an empty table of poses from the store's."""
    for i in range(len(store.pose_slot)):
        node = store.pose_slot[i]
        if node != 0:
            pose_slot[_pose_place(store.origin, pose_slot, store.origin[(node - 1) // BLOCK])] = node


@njit(inline="always")
def key_of(store, node):
    """Packed state at a node."""
    block, cell = node // BLOCK, node % BLOCK
    tile = np.int64(store.origin[block])
    if tile < 0:
        return (-1 - tile) << HEADING_SHIFT | np.int64(store.word[node]) >> _FEET_SHIFT
    column, y = tile // store.tiles_y, tile % store.tiles_y
    heading, x = column // store.tiles_x, column % store.tiles_x
    return pack(x * TILE + cell // TILE, y * TILE + cell % TILE, heading, 0, 0, 0, 0) | store.neutral


@njit(allocates=False)
def find(store, key):
    """Node for a packed state, -1 if the store has none."""
    if key & FEET_MASK == store.neutral:
        block = np.int64(store.directory[_tile(store, key)])
        return BLOCK * block + _cell(key) if block > 0 else np.int64(-1)
    s = _home(_hash(key), len(store.slot))
    while store.slot[s] != 0:
        node = np.int64(store.slot[s]) & ((np.int64(1) << store.node_bits) - 1)
        if _is_at(store, node, key):
            return node
        s = s + 1 if s + 1 < len(store.slot) else 0
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
