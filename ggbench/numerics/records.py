"""Records: sets of many arrays that kernels pass by a single address.

Compiled code passes a named tuple of arrays to a function as separate numbers. Each array needs
seven or more numbers, such as address, shape and strides. For a model with thirty arrays, copying
these numbers would be most of the compiled code.
A record is stored in memory and passed by its address, as in :mod:`numba.experimental.structref`.
In Python a record is a frozen dataclass.
"""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from functools import cache, cached_property, partial
from typing import Any, TypeVar, dataclass_transform

from numba import typeof, types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed
from numba.experimental import structref
from numba.extending import NativeValue, intrinsic, unbox

from .kernels import compiled

_Class = TypeVar("_Class", bound=type)
_MEMORY = types.MemInfoPointer(types.voidptr)


@dataclass_transform(frozen_default=True, eq_default=False)
def record(cls: _Class) -> _Class:
    """Turn a class with annotated fields into a record, which kernels accept, create and pass on.

    Fields cannot be set. Arrays in fields are shared and can be filled. A record returned by a
    kernel is usable only in kernels.
    """
    made: Any = dataclasses.dataclass(frozen=True, eq=False)(cls)
    names = [field.name for field in dataclasses.fields(made)]
    structref.define_constructor(made, partial(RecordType, made), names)

    def hold(values: Any) -> Any:
        return _memory_of(made(*values))

    # Kept on disk with the code of the class's own module.
    hold.__qualname__ = f"{made.__qualname__}.hold"
    file = getattr(sys.modules[made.__module__], "__file__", None)  # a notebook has none
    hold.__code__ = hold.__code__.replace(co_filename=file or f"<{made.__module__}>")
    held = compiled(hold)
    computed = {
        "_memory": lambda value: held(fields_of(value)),
        # By this name numba asks a value for its type.
        "_numba_type_": lambda value: _type_of(made, tuple(map(typeof, fields_of(value)))),
    }
    for name, function in computed.items():
        attribute: Any = cached_property(function)
        attribute.__set_name__(made, name)
        setattr(made, name, attribute)
    # Without what is computed: an address means nothing to another process.
    made.__getstate__ = lambda value: dict(zip(names, fields_of(value), strict=True))
    return made


@cache
def _type_of(made: type, kinds: tuple[Any, ...]) -> RecordType:
    """Return the type of a record with fields of some types.

    It is cached, because to make its long name takes time, and there are fewer types than records.
    """
    names = [field.name for field in dataclasses.fields(made)]
    return RecordType(made, zip(names, kinds, strict=True))


def fields_of(value: Any) -> tuple[Any, ...]:
    """Return the fields of a record, in the order of its class."""
    return tuple(getattr(value, field.name) for field in dataclasses.fields(value))


class RecordType(types.StructRef):
    """Numba type of a record, from the class of the record and the types of the fields."""

    def __init__(self, made: type, fields: Any) -> None:
        self.made = made
        super().__init__(tuple(fields))
        # What numba makes of the fields has thousands of letters, and is part of many names.
        digest = hashlib.sha256(self.name.encode()).hexdigest()[:16]
        self.name = f"{made.__module__}.{made.__qualname__}.{digest}"

    def preprocess_fields(self, fields: Any) -> Any:
        """Return the names and types of the fields, with general types instead of literal types."""
        return [(name, types.unliteral(kind)) for name, kind in fields]


structref.register(RecordType)


def _memory(typing: Any, value: Any) -> Any:
    """Generate the code that returns the memory in which a record is held."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        held = cgutils.create_struct_proxy(value)(context, builder, value=arguments[0])
        return impl_ret_borrowed(context, builder, _MEMORY, held.meminfo)

    return _MEMORY(value), generate


_memory_of: Any = intrinsic(_memory)


@unbox(RecordType)
def _from_python(kind: Any, value: Any, code: Any) -> Any:
    """Generate the code that converts a record of Python to a record of compiled code."""
    memory = code.pyapi.object_getattr_string(value, "_memory")
    failed = cgutils.is_null(code.builder, memory)
    held = cgutils.create_struct_proxy(kind)(code.context, code.builder)
    with code.builder.if_then(code.builder.not_(failed)):
        held.meminfo = code.unbox(_MEMORY, memory).value
        code.pyapi.decref(memory)
    return NativeValue(held._getvalue(), is_error=failed)
