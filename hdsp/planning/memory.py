"""Memory of a query: the part that its heuristic takes, and the part that is left to its searches and proofs.

A limit counts all arrays that a query creates: map-wide results of the heuristic (an earlier query may have made them),
costs-to-go for the goals, features kept for later queries, other ground under the start, states, open lists, a backward
search, and a proof. The planner's own arrays, made at its construction, do not count.
"""

from __future__ import annotations

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.search.open_list import new_open_list
from hdsp.detailed.search.store import new_store
from hdsp.detailed.states import neutral_feet
from hdsp.detailed.world.world import World

# Bytes for a cell of the map: reachable headings of a search that ends without a plan; a proof with its queues.
_REACHED, _PROOF = 16, 160
_MIB = 1 << 20


def least_memory(world: World) -> int:
    """Bytes of an empty search, and of the report on one that ends without a plan."""
    store = new_store((world.nx, world.ny), neutral_feet(world.tables.lowest))
    return store.nbytes() + new_open_list().nbytes() + _REACHED * world.nx * world.ny


def proof_memory(world: World) -> int:
    """Bytes of a proof that no plan exists, at most."""
    return _PROOF * len(world.standable)


def own_memory(world: World, shared: World) -> int:
    """Bytes of the arrays of a world that another one does not share."""
    pairs = ((getattr(world, name), getattr(shared, name)) for name in world._fields)
    return sum(one.nbytes for one, other in pairs if isinstance(one, np.ndarray) and one is not other)


def memory_limit(asked: int, needed: int) -> int:
    """Returns the limit of a query in bytes.

    Args:
        asked: the limit as asked.
        needed: bytes of the heuristic and of an empty search.

    Raises:
        InputError: the limit is below the need; the message names it in whole MiB, rounded up.
    """
    if asked < needed:
        # Whole MiB, which suffice later, too: results that later queries share may add some bytes.
        least = -(-needed // _MIB) * _MIB
        raise InputError(f"memory is {asked}; a query on this map needs {least} bytes at least")
    return asked
