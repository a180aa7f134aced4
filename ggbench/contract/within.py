"""Search for all arrays within an object, to detect changes of a problem."""

from __future__ import annotations

import gc
import types
from collections.abc import Iterator

import numpy as np


def arrays_within(*roots: object) -> list[np.ndarray]:
    """Return all arrays, of any shape (...), that are reachable from the given objects."""
    items: dict[int, object] = {}
    waiting = list(roots)
    while waiting:
        item = waiting.pop()
        if id(item) not in items:
            items[id(item)] = item  # kept, so that its identity is not used again
            waiting.extend(_inner(item))
    return [item for item in items.values() if isinstance(item, np.ndarray)]


def _inner(item: object) -> Iterator[object]:
    """Yield the contents of an object: attributes, elements, closures, memory owners; no code."""
    if isinstance(item, np.ndarray):
        yield item.base
        if item.dtype == object:
            yield from item.ravel()
    elif isinstance(item, types.FunctionType):
        yield from (cell.cell_contents for cell in item.__closure__ or ())
        yield item.__defaults__
        yield item.__kwdefaults__
    elif not isinstance(item, type | types.ModuleType):
        yield from gc.get_referents(item)
        yield from getattr(item, "__dict__", {}).values()
        for cls in type(item).__mro__:
            for slot in getattr(cls, "__slots__", ()):
                yield getattr(item, slot, None)
