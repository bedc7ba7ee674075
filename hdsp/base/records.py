"""Named tuples of arrays and numbers that kernels take by reference.

Numba passes a named tuple by value: a terrain with its tables is five hundred numbers, which each inlined function
copies and LLVM takes apart again. A record is one address instead. Its fields lie in a block of memory that Python
writes at the first call, and a kernel loads a field where it uses one. Compilation takes a fraction of the time, and a
record as the argument of a function that is not inlined costs nothing.

The block holds values, data addresses, shapes and strides. A record is as constant as the tuple: LLVM may keep a loaded
field for as long as it likes (``invariant.load``). Contents of arrays may change.
"""

import hashlib
from typing import Any, TypeVar

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate
from numba.extending import NativeValue, infer_getattr, register_model, typeof_impl, unbox

_Class = TypeVar("_Class", bound=type)
_WORD = 8  # bytes of an entry in a block


class RecordType(types.Type):
    """Type of a record: its class and the types of its fields.

    Args:
        name: the class, in words.
        fields: pairs of name and type.
    """

    def __init__(self, name: str, fields: tuple[tuple[str, types.Type], ...]):
        self.fields = fields
        self.types = dict(fields)
        self.places: dict[str, int] = {}
        words = 0
        for field, kind in fields:
            self.places[field] = words * _WORD
            words += 2 + 2 * kind.ndim if isinstance(kind, types.Array) else 1
        # Names of types are parts of all symbols: a short one saves time.
        digest = hashlib.sha256(repr([(field, str(kind)) for field, kind in fields]).encode()).hexdigest()[:16]
        super().__init__(name=f"{name}-{digest}")

    @property
    def key(self) -> Any:
        return self.name


register_model(RecordType)(models.OpaqueModel)


def by_reference(cls: _Class) -> _Class:
    """Class decorator: kernels take instances of a named tuple by reference."""

    class Record(cls):  # type: ignore[valid-type, misc]
        __doc__ = cls.__doc__

        @property
        def _address(self) -> int:
            """Address of the block, which lives as long as the tuple."""
            block = self.__dict__.get("_block")
            if block is None:
                # Two threads may get here: the first block stays.
                block = self.__dict__.setdefault("_block", _written(self))
            return block[0]

        def __getstate__(self) -> None:
            """No address survives pickling."""

    for name in ("__name__", "__qualname__", "__module__"):
        setattr(Record, name, getattr(cls, name))
    label = f"{cls.__module__}.{cls.__qualname__}"

    def typeof(record: Any, c: Any) -> RecordType:
        return RecordType(label, tuple((name, _type_of(name, getattr(record, name), c)) for name in Record._fields))

    typeof_impl.register(Record)(typeof)
    return Record  # type: ignore[return-value]


def _type_of(name: str, value: Any, c: Any) -> types.Type:
    if isinstance(value, (bool, np.bool_)):
        return types.boolean
    if isinstance(value, (int, np.integer)):
        return types.int64
    if isinstance(value, (float, np.floating)):
        return types.float64
    found = typeof_impl(value, c)
    if not isinstance(found, (types.Array, RecordType)):
        raise TypeError(f"field {name} is a {type(value).__name__}; need a number, an array or a record")
    return found


def _written(record: Any) -> tuple[int, np.ndarray]:
    """The block for a record: its address, and the array that owns it."""
    words: list[int] = []
    for value in record:
        if isinstance(value, np.ndarray):
            words += (value.__array_interface__["data"][0], value.size, *value.shape, *value.strides)
        elif isinstance(value, tuple):
            words.append(value._address)  # type: ignore[attr-defined]
        elif isinstance(value, (float, np.floating)):
            words.append(int(np.float64(value).view(np.int64)))
        else:
            words.append(int(value))
    block = np.array(words, np.int64)
    return block.__array_interface__["data"][0], block


@unbox(RecordType)
def _unboxed(kind: RecordType, value: Any, c: Any) -> NativeValue:
    number = c.pyapi.object_getattr_string(value, "_address")
    address = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(address, is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


@infer_getattr
class _Fields(AttributeTemplate):
    key = RecordType

    def generic_resolve(self, kind: RecordType, name: str) -> Any:  # type: ignore[override]
        return kind.types.get(name)


@lower_getattr_generic(RecordType)
def _field(context: Any, builder: Any, kind: RecordType, address: Any, name: str) -> Any:
    found, place = kind.types[name], kind.places[name]

    def load(index: int, as_type: Any) -> Any:
        at = builder.gep(address, [ir.Constant(ir.IntType(64), place + _WORD * index)])
        loaded = builder.load(builder.bitcast(at, as_type.as_pointer()), align=_WORD)
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    word = ir.IntType(64)
    if isinstance(found, RecordType):
        return load(0, address.type)
    if not isinstance(found, types.Array):
        if isinstance(found, types.Boolean):
            return builder.trunc(load(0, word), ir.IntType(1))
        return load(0, context.get_value_type(found))
    array = context.make_array(found)(context, builder)
    data = load(0, array.data.type)
    n = found.ndim
    array.data, array.nitems = data, load(1, word)
    array.itemsize = ir.Constant(word, context.get_abi_sizeof(context.get_data_type(found.dtype)))
    array.shape = cgutils.pack_array(builder, [load(2 + i, word) for i in range(n)], ty=word)
    array.strides = cgutils.pack_array(builder, [load(2 + n + i, word) for i in range(n)], ty=word)
    array.meminfo = cgutils.get_null_value(array.meminfo.type)
    array.parent = cgutils.get_null_value(array.parent.type)
    return array._getvalue()
