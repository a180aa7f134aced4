"""Tables of a scenario as keys of caches: fixed, and equal exactly if all of their keys are."""

from __future__ import annotations

import collections.abc
import os
import pickle
import subprocess
import sys
import tomllib
import typing
from collections.abc import Iterator
from typing import Any, get_args

import pytest
from problems import SMALL
from pydantic import BaseModel, ValidationError
from small_cases import GRAVIMETER, ON_BOARD, ROTATING, SEVERAL, small_case

from ggbench.spec import scenario
from ggbench.spec.aiding import AidingSpec, GnssSpec
from ggbench.spec.axes import AxisSpec, SweepSpec
from ggbench.spec.campaign import CampaignSpec
from ggbench.spec.case import CaseSpec
from ggbench.spec.named_sensors import NamedSensors
from ggbench.spec.tables import Section

EVERYTHING = (
    ROTATING
    | ON_BOARD
    | GRAVIMETER
    | SEVERAL
    | {
        "imu.gyro_bias_time_s": 100.0,
        "altimeter.noise_m_per_sqrt_hz": 1.0,
        "initial_error.height_m": 9.0,
        "windows.required_m": 10.0,
        "model.disturbance.horizontal_mgal": 30.0,
        "field": {"source": "map.nc", "error": {"resolution_km": 2.0}},
        "truth.gradiometer.rotating.vibration_mps2": 0.1,
        "truth.gradiometer.dropouts_s": [[1.0, 2.0], [3.0, 4.0]],
        "truth.field.error": {"seed": 2},
        "model.field.error": {"seed": 3},
        "truth.sensor.water_track.outlier_share": 0.1,
        "truth.sensor.water_track.outlier_mps": 1.0,
        "model.sensor.stern.position_noise_m": 9.0,
    }
)
"""Changes of the small case that give it every table that a case may have, but some of sensors."""
for spec in get_args(AidingSpec):
    noise = next(key for key in spec.model_fields if "noise" in key)
    for prefix, change in (
        ("", {"kind": spec.model_fields["kind"].default, "period_s": 1.0, noise: 1.0}),
        ("truth.", {"dropout_share": 0.1}),
        ("model.", {noise: 2.0}),
    ):
        EVERYTHING |= {f"{prefix}sensor.a_{spec.__name__}.{key}": x for key, x in change.items()}
MUTABLE = (list, dict, set, collections.abc.Mapping, collections.abc.Sequence)


def tables(model: type[BaseModel]) -> set[type[BaseModel]]:
    """A class of tables and those of all tables within it."""
    found = {model}
    for field in model.model_fields.values():
        for inner in parts(field.annotation):
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                found |= tables(inner)
    return found


def parts(annotation: Any) -> Iterator[Any]:
    """What an annotation is made of, itself first."""
    yield annotation
    for inner in typing.get_args(annotation):
        yield from parts(inner)


TABLES = sorted(
    {table for model in (CaseSpec, CampaignSpec, SweepSpec) for table in tables(model)},
    key=lambda table: table.__name__,
)


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_every_table_is_fixed_and_holds_nothing_that_changes(table):
    """No key of a table can be set, no list or dict can be one, and defaults are hashable."""
    assert issubclass(table, Section)
    some = table.model_construct()
    for name, field in table.model_fields.items():
        with pytest.raises(ValidationError, match="frozen"):
            setattr(some, name, None)
        kinds = {typing.get_origin(part) or part for part in parts(field.annotation)}
        assert not kinds & set(MUTABLE)
        hash(field.default)


def variants(value: Any) -> Iterator[Any]:
    """The value with one key of any of its tables, or one item of its tuples, another."""
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            for other in variants(getattr(value, name)):
                yield value.model_copy(update={name: other})
    elif isinstance(value, NamedSensors):
        yield NamedSensors({**value, "one_more": GnssSpec(period_s=1.0, position_noise_m=1.0)})
        for name, table in value.items():
            for other in variants(table):
                yield NamedSensors({**value, name: other})
    elif isinstance(value, tuple):
        yield (*value, "one more")
        for i, item in enumerate(value):
            for other in variants(item):
                yield (*value[:i], other, *value[i + 1 :])
    elif isinstance(value, bool):
        yield not value
    elif isinstance(value, int | float):
        yield value + 1
    else:
        yield f"other than {value}"


def test_cases_that_differ_in_any_key_are_two():
    """Whichever key of whichever table is another, the case is; read again, it is the same one."""
    case = small_case(EVERYTHING)
    used = {type(case)}
    waiting: list[BaseModel] = [case]
    while waiting:
        held = [value for _, value in waiting.pop()]
        held += [item for value in held if isinstance(value, tuple) for item in value]
        held += [t for value in held if isinstance(value, NamedSensors) for t in value.values()]
        waiting += [value for value in held if isinstance(value, BaseModel)]
        used |= {type(value) for value in waiting}
    assert used | {type(small_case().reference)} == tables(CaseSpec)
    others = list(variants(case))
    assert len(others) > 150
    assert case not in others
    assert {"stern", "water_track"} < case.sensor.keys()
    assert len({case, *others}) == len({hash(item) for item in (case, *others)}) == 1 + len(others)
    again = small_case(EVERYTHING)
    assert again is not case
    assert (again, hash(again)) == (case, hash(case))


def test_a_sweep_is_hashable_whatever_it_changes():
    """Axes that change whole tables and lists of tables are keys like any other; order is none."""

    def axis(*changes: dict[str, Any]) -> AxisSpec:
        return AxisSpec(name="x", label="x", values=[1, 2], changes=list(changes))

    legs = {"trajectory": {"segment": [{"duration_s": 9.0}], "repeat": 2}, "altimeter": {}}
    one, same = axis(legs, {}), axis({"altimeter": {}, "trajectory": legs["trajectory"]}, {})
    assert (one, hash(one)) == (same, hash(same))
    assert one != axis(legs, {"altimeter": {}})
    assert [one.change(i) for i in range(2)] == [legs, {}]
    assert one.changed_keys() == {"trajectory.segment", "trajectory.repeat"}
    with pytest.raises(ValidationError, match="must be a table, found 3"):
        axis({}, 3)
    assert hash(SweepSpec(axis=[one])) == hash(SweepSpec(axis=[same]))
    assert hash(scenario.load("noise_rate_sweep")) == hash(scenario.load("noise_rate_sweep"))


def test_numbers_that_are_equal_are_the_same_to_the_bit():
    """A zero has no sign and a whole number is one with a point: equal cases fly alike."""
    plain = small_case({"trajectory.roll_deg": 0.0, "trajectory.heading_deg": 90.0})
    odd = small_case({"trajectory.roll_deg": -0.0, "trajectory.heading_deg": 90})
    assert plain == odd
    assert plain.model_dump_json() == odd.model_dump_json()
    assert plain.content_hash == odd.content_hash


@pytest.mark.long
def test_a_case_is_the_same_in_another_process(tmp_path):
    """A case that a worker is sent is the key that the worker would make, whatever its hashes."""
    (tmp_path / "small.toml").write_text(SMALL)
    case = scenario.parse(tomllib.loads(SMALL), "small", "small").cases[0]
    hash(case)
    (tmp_path / "case").write_bytes(pickle.dumps(case))
    code = (
        "import pickle; from ggbench.spec import scenario;"
        "case = pickle.load(open('case', 'rb'));"
        "own = scenario.load('small.toml').cases[0];"
        "assert own == case and hash(own) == hash(case) and {own: 1}[case];"
        "print(hash(case))"
    )
    seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    printed = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        text=True,
        capture_output=True,
        check=True,
        env=os.environ | {"PYTHONHASHSEED": seed},
    ).stdout
    assert int(printed) != hash(case)
