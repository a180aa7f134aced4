import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest

from ggbench.numerics.kernels import compiled
from ggbench.numerics.records import fields_of, record


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
