"""Named tuples by reference: kernels read the same values as Python, and no address outlives its tuple."""

import copy
import pickle
from typing import NamedTuple

import numpy as np
import pytest

from hdsp.base.jit import njit
from hdsp.base.records import by_reference


@by_reference
class Inner(NamedTuple):
    values: np.ndarray
    scale: float


@by_reference
class Outer(NamedTuple):
    flag: bool
    number: int
    grid: np.ndarray
    inner: Inner


@njit(allocates=False)
def total(record, ix, iy):
    record.inner.values[1] += 1.0
    found = record.grid[ix, iy] * record.inner.scale + record.inner.values[len(record.inner.values) - 1]
    return found + record.number if record.flag else found


def example(flag: bool = True) -> Outer:
    grid = np.arange(12, dtype=np.int32).reshape(3, 4)
    return Outer(flag, 7, grid, Inner(np.array([1.5, 2.5, -3.0]), 0.5))


@pytest.mark.parametrize("flag", [True, False])
def test_a_kernel_reads_the_fields_and_writes_into_the_arrays(flag):
    record = example(flag)
    for ix in range(3):
        for iy in range(4):
            assert total(record, ix, iy) == total.py_func(record, ix, iy)
    assert record.inner.values[1] == 2.5 + 24


def test_copies_with_other_arrays_are_read_at_their_own_place():
    record = example()
    assert total(record, 2, 3) == 11 * 0.5 - 3 + 7
    for other in (pickle.loads(pickle.dumps(record)), copy.copy(record), copy.deepcopy(record)):
        assert type(other) is Outer and total(other, 2, 3) == 11 * 0.5 - 3 + 7
    changed = record._replace(number=8, inner=record.inner._replace(values=np.array([0.0, 0.0, 10.0])))
    del record
    assert total(changed, 2, 3) == 11 * 0.5 + 10 + 8


def test_a_record_is_a_named_tuple_and_refuses_other_fields():
    record = example()
    assert record._fields == ("flag", "number", "grid", "inner") and record[1] == 7 and "_block" not in repr(record)
    with pytest.raises(Exception, match="field values"):
        total(record._replace(inner=Inner("words", 1.0)), 0, 0)  # type: ignore[arg-type]
