"""Tables lent to compiled code (`mech.kinds.table`), as numba sees them: one address, read where a field is.

numba's own named tuple is a value: all fields of all arrays, some four hundred numbers for the plan of a
step, are loaded at the start and handed on at every call. An address costs nothing to hand on, and only
what a function asks for is loaded.
"""

from __future__ import annotations

from typing import Any

import numba.core.cgutils
import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

from mech.kinds import fields_of

__all__ = ["element_type", "kind_of", "lent"]

_WORD = ir.IntType(64)


class Table(types.Type):  # type: ignore[misc]
    """The table of a named tuple of numbers and arrays.

    Attributes
    ----------
    fields : by name, the type of a field and the number of its first word
    """

    def __init__(self, cls: Any) -> None:
        super().__init__(f"{cls.__module__}.{cls.__qualname__}")
        self._cls = cls
        self.fields: dict[str, tuple[Any, int]] = {}
        at = 0
        for name, kind in zip(cls._fields, fields_of(cls), strict=True):
            if kind is int or kind is float:
                item, words = types.int64 if kind is int else types.float64, 1
            else:
                item = types.Array(element_type(kind.element), kind.dimensions, "C")
                words = 1 + kind.dimensions
            self.fields[name] = item, at
            at += words

    @property
    def key(self) -> Any:
        """What tells a table from others."""
        return self._cls


@register_model(Table)
class _TableModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _WORD.as_pointer())


@infer_getattr
class _TableFields(AttributeTemplate):  # type: ignore[misc]
    key = Table

    def generic_resolve(self, kind: Any, name: str) -> Any:
        return kind.fields[name][0] if name in kind.fields else None


@lower_getattr_generic(Table)
def _field(context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
    """Load a field. No table changes while compiled code runs: what is loaded once need not be again."""
    item, at = kind.fields[name]
    unchanging = builder.module.add_metadata([])

    def word(number: int, value_type: Any) -> Any:
        place = builder.gep(address, [ir.Constant(_WORD, at + number)], inbounds=True)
        loaded = builder.load(builder.bitcast(place, value_type.as_pointer()))
        loaded.set_metadata("invariant.load", unchanging)
        return loaded

    if not isinstance(item, types.Array):
        return word(0, context.get_value_type(item))
    array = context.make_array(item)(context, builder)
    array.data = word(0, array.data.type)
    lengths = [word(1 + each, _WORD) for each in range(item.ndim)]
    count = ir.Constant(_WORD, 1)
    stride = ir.Constant(_WORD, item.dtype.bitwidth // 8)
    array.itemsize = stride
    strides: list[Any] = []
    for length in reversed(lengths):
        strides.insert(0, stride)
        stride = builder.mul(stride, length)
        count = builder.mul(count, length)
    array.shape = numba.core.cgutils.pack_array(builder, lengths)
    array.strides = numba.core.cgutils.pack_array(builder, strides)
    array.nitems = count
    # it owns nothing: references to it are counted nowhere
    array.meminfo = ir.Constant(array.meminfo.type, None)
    array.parent = ir.Constant(array.parent.type, None)
    return array._getvalue()


def kind_of(cls: Any) -> Any:
    """Return numba's type of a structured dtype, or of the table of a named tuple."""
    return from_dtype(cls) if isinstance(cls, np.dtype) else Table(cls)


def element_type(element: Any) -> Any:
    """Return numba's type of an array's elements, structured ones too."""
    return from_dtype(np.dtype(element))


@intrinsic
def _lent(typing_context: Any, address: Any, kind: Any) -> Any:
    """Return the table of the type `kind` at an integer address."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], _WORD.as_pointer())

    return kind.instance_type(types.int64, kind), codegen


# An intrinsic's first parameter is the compiler's own: callers see it without.
lent: Any = _lent
