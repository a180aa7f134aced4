import dataclasses
import gc
import importlib
import pickle
import pkgutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

import numpy as np
import pytest

import ggbench
from ggbench.numerics.compiling import Kernel
from ggbench.numerics.kernels import compiled
from ggbench.numerics.records import fields_of, record
from ggbench.numerics.source import COMPILED_ROOMS


@record
class Inner:
    numbers: np.ndarray
    count: int


@record
class Outer:
    weights: np.ndarray
    inner: Inner


@compiled
def _weighted(value: Outer) -> float:
    return (value.weights * value.inner.numbers).sum() * value.inner.count


@compiled
def _of_new_record(value: Outer) -> float:
    return _weighted(Outer(value.weights, Inner(value.inner.numbers, value.inner.count + 1)))


@compiled
def _fill(value: Outer) -> None:
    value.inner.numbers[:] = value.weights


@compiled
def _returned(value: Outer) -> Inner:
    return value.inner


def some(count: int = 2) -> Outer:
    return Outer(np.array([1.0, 2.0]), Inner(np.array([3.0, 4.0]), count))


def test_kernels_read_the_fields_of_a_record():
    assert _weighted(some()) == 22.0


def test_kernels_make_records_of_records():
    assert _of_new_record(some()) == 33.0


def test_another_value_of_the_same_types_needs_no_other_code():
    _weighted(some())
    compiled_before = len(_weighted.signatures)
    assert _weighted(some(5)) == 55.0
    assert len(_weighted.signatures) == compiled_before


def test_arrays_of_other_types_have_code_of_their_own():
    other = Outer(np.array([1, 2]), Inner(np.array([3.0, 0.0, 4.0])[::2], 2))
    assert _weighted(other) == 22.0


def test_arrays_are_shared_with_kernels():
    value = some()
    _fill(value)
    assert value.inner.numbers.tolist() == [1.0, 2.0]
    value.inner.numbers[0] = 10.0
    assert _weighted(value) == 28.0


def test_arrays_outlive_the_value_that_python_held():
    def memory_alone():
        return some()._memory

    held = [memory_alone() for _ in range(100)]
    value = some()
    vars(value)["_memory"] = held[0]
    assert _weighted(value) == 22.0


def test_a_field_cannot_be_set():
    with pytest.raises(dataclasses.FrozenInstanceError):
        some().weights = np.zeros(2)


def test_a_changed_copy_is_what_kernels_see():
    value = some()
    assert _weighted(value) == 22.0
    assert _weighted(dataclasses.replace(value, weights=np.zeros(2))) == 0.0


def test_a_record_comes_through_a_pickle_without_its_address():
    value = some()
    _weighted(value)
    there = pickle.loads(pickle.dumps(value))
    assert set(vars(there)) == {"weights", "inner"}
    assert _weighted(there) == 22.0


def test_fields_come_in_the_order_of_the_class():
    value = some()
    assert fields_of(value) == (value.weights, value.inner)


def test_a_record_of_a_kernel_stays_in_kernels():
    with pytest.raises(TypeError, match="cannot convert native"):
        _returned(some())


def test_what_fails_as_memory_is_filled_is_an_error_of_the_call(monkeypatch):
    def fails(value):
        raise RuntimeError("no memory")

    monkeypatch.setattr(Outer, "_memory", property(fails))
    with pytest.raises(RuntimeError, match="no memory"):
        _weighted(some())


def test_the_code_of_a_record_is_kept_with_its_module():
    """The types in an index of code on disk are found by whoever loads it."""
    code = Inner._memory.func.__closure__
    kept = [cell.cell_contents for cell in code if hasattr(cell.cell_contents, "py_func")]
    assert [Path(each.py_func.__code__.co_filename) for each in kept] == [Path(__file__)]


def test_arrays_are_freed_with_the_record():
    numbers = np.ones(3)
    value = Outer(np.ones(3), Inner(numbers, 1))
    _weighted(value)
    assert sys.getrefcount(numbers) > 2
    del value
    gc.collect()
    assert sys.getrefcount(numbers) == 2


def named_tuples_of_arrays(kernels: Iterable[Any]) -> list[str]:
    """Return the parameters of kernels that are named tuples with arrays in them."""
    return [
        f"{kernel.py_func.__module__}.{kernel.py_func.__name__}: {name}"
        for kernel in kernels
        for name, kind in get_type_hints(kernel.py_func).items()
        if issubclass(kind if isinstance(kind, type) else object, tuple)
        and np.ndarray in get_type_hints(kind).values()
    ]


def test_kernels_take_groups_of_arrays_as_records():
    """All kernels of the package and of the shipped estimators."""
    modules = [
        importlib.import_module(found.name)
        for found in pkgutil.walk_packages(ggbench.__path__, "ggbench.")
        if found.name.split(".")[1] in (*COMPILED_ROOMS, "estimators")
    ]
    kernels = [
        each for module in modules for each in vars(module).values() if isinstance(each, Kernel)
    ]
    assert len(kernels) > 300
    assert named_tuples_of_arrays(kernels) == []


class _Pair(NamedTuple):
    one: np.ndarray
    other: int


@compiled
def _of_tuple(pair: _Pair) -> float:
    return pair.one[pair.other]


def test_a_kernel_that_takes_a_named_tuple_of_arrays_is_seen():
    assert named_tuples_of_arrays([_of_tuple]) == [f"{__name__}._of_tuple: pair"]
