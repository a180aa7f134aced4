"""Arrays that are handed out: nobody who holds one changes it for the others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ggbench.numerics.frozen import freeze_arrays, frozen, read_only


def test_a_frozen_array_is_a_copy_that_nobody_can_change():
    """Not by its source, not by writing, and not by making it writeable first."""
    source = np.arange(12.0).reshape(3, 4)
    kept = frozen(source)
    source[:] = -1.0
    np.testing.assert_array_equal(kept, np.arange(12.0).reshape(3, 4))
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 0.0
    with pytest.raises(ValueError, match="cannot set WRITEABLE"):
        kept.flags.writeable = True


def test_a_read_only_array_is_no_copy_and_leaves_its_source_as_it_is():
    source = np.arange(4.0)
    seen = read_only(source)
    with pytest.raises(ValueError, match="read-only"):
        seen[0] = 1.0
    source[0] = 7.0  # whose array it is may go on
    assert seen[0] == 7.0
    assert read_only(seen) is seen
    assert read_only(np.arange(6).reshape(2, 3).T).flags.c_contiguous


def test_all_arrays_of_a_record_are_frozen():
    @dataclasses.dataclass(frozen=True)
    class Record:
        values: np.ndarray
        name: str

        def __post_init__(self) -> None:
            freeze_arrays(self)

    source = np.zeros(3)
    record = Record(source, "x")
    source[0] = 1.0
    assert record.values.tolist() == [0.0, 0.0, 0.0] and record.name == "x"
    with pytest.raises(ValueError, match="read-only"):
        record.values[0] = 1.0
