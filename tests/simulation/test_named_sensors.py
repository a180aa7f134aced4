"""Several sensors of a kind: each has its own rate, noise, faults, biases and random numbers."""

from __future__ import annotations

import itertools
import re
import tomllib
from typing import get_args

import numpy as np
import pytest
from problems import SMALL
from small_cases import (
    ON_BOARD,
    SEVERAL,
    residuals_at_the_truth,
    small_case,
    small_flight,
)
from test_other_sensors import places

from ggbench.campaign import records
from ggbench.errors import GGBenchError
from ggbench.judging import situations
from ggbench.problem import Problem
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.simulation.runs import simulate, simulate_block
from ggbench.spec import scenario
from ggbench.spec.aiding import KINDS, AidingSpec
from ggbench.spec.case import CaseSpec
from ggbench.spec.flight import FlightSpec
from ggbench.spec.merging import merged
from ggbench.spec.named_sensors import RESERVED
from ggbench.spec.scenario import checked
from ggbench.spec.tables import nested
from ggbench.spec.unusual_values import unusual_in

NAMES = ["bow_2", "sea_level", "stern", "water_track"]
RUNS = 40


def readings(problem: Problem, sensor: str) -> np.ndarray:
    """The readings of a sensor (G, c) at the epochs at which it is read."""
    own = places(problem, sensor)
    return problem.measurements[problem.present[:, own[0]]][:, own]


def test_channels_and_biases_are_in_the_order_of_the_kinds_then_of_the_names():
    """Whatever the order in the file; each is read at its own rate and has its own bias states."""
    flight = small_flight(ON_BOARD | SEVERAL)
    problem, _ = simulate(flight, 1, 0)
    sensors = list(dict.fromkeys(channel.sensor for channel in problem.channels))
    assert sensors == ["gradiometer", *KINDS[:3], *NAMES]
    assert [block.name for block in problem.layout][5:] == [
        "velocity log bias",
        "barometer bias",
        "sea level bias",
        "water track bias",
    ]
    assert list(flight.case.periods) == sensors
    for sensor, period in flight.case.periods.items():
        there = problem.present[:, places(problem, sensor)].all(axis=1)
        read = np.abs(np.round(problem.times / period) * period - problem.times) < 1e-9
        assert np.array_equal(there, read), sensor


def test_residuals_at_the_truth_are_the_noise_that_is_told():
    """Biases land in their own states: white, within 4 deviations of the mean of 40 runs.

    The bias of the water track is 8 times its noise. False alarms: 22 channels times 6e-5.
    """
    block, truth = simulate_block(small_flight(ON_BOARD | SEVERAL), 3, range(RUNS))
    squares, count = residuals_at_the_truth(block, truth)
    assert (np.abs(squares / count - 1.0) < 4.0 * np.sqrt(2.0 / count)).all()


def test_a_bias_is_felt_by_its_own_sensor_alone():
    """A channel's row has one for its own bias and nothing for those of others of its kind."""
    problem, _ = simulate(small_flight(ON_BOARD | SEVERAL), 1, 0)
    blocks = {block.name: block.slice for block in problem.layout}
    biases = slice(blocks["velocity log bias"].start, problem.dimension)
    k = int(problem.present.all(axis=1).argmax())
    jacobian = problem.model.jacobian(k, np.zeros(problem.dimension))[:, biases]
    felt = {
        name: jacobian[places(problem, sensor)]
        for name, sensor in (
            ("velocity log bias", "velocity_log"),
            ("barometer bias", "barometer"),
            ("sea level bias", "sea_level"),
            ("water track bias", "water_track"),
        )
    }
    assert not jacobian[places(problem, "stern") + places(problem, "bow_2")].any()
    for name, rows in felt.items():
        own = slice(blocks[name].start - biases.start, blocks[name].stop - biases.start)
        np.testing.assert_array_equal(rows[:, own], np.eye(len(rows)))
        assert rows.sum() == len(rows)
    prior = np.sqrt(np.diag(problem.prior_cov))[biases]
    np.testing.assert_allclose(prior, [0.2, 0.2, 5.0, 2.0, 0.4, 0.4])
    kept = np.diag(problem.transition[1])[biases]
    np.testing.assert_allclose(
        kept, np.repeat(np.exp([-0.5 / 30.0, 0.0, -0.5 / 20.0]), [2, 2, 2]), rtol=1e-12
    )


# Random numbers.


def test_sensors_change_no_random_number_of_others():
    """Neither the first four of their kinds nor named ones: all readings are those to the bit."""
    alone, _ = simulate(small_flight(ON_BOARD), 1, 0)
    every, _ = simulate(small_flight(ON_BOARD | SEVERAL), 1, 0)
    assert np.array_equal(alone.track.positions, every.track.positions)
    for sensor in ("gradiometer", *KINDS[:3]):
        np.testing.assert_array_equal(readings(alone, sensor), readings(every, sensor))
    log = {key: x for key, x in SEVERAL.items() if ".water_track." in key}
    struck = {"dropout_share": 0.3, "outlier_share": 0.3, "outlier_mps": 10.0}
    faults = {
        f"truth.{table}.{key}": x
        for table in ("velocity_log", "sensor.water_track")
        for key, x in struck.items()
    }
    own = {key: x for key, x in faults.items() if ".sensor." in key}
    # A bias is drawn from epoch to epoch: the barometer has those of all.
    log |= {key: x for key, x in ON_BOARD.items() if key.startswith("barometer")}
    alone, _ = simulate(small_flight({"gradiometer": None} | log | own), 1, 0)
    every, _ = simulate(small_flight(ON_BOARD | SEVERAL | faults), 1, 0)
    np.testing.assert_array_equal(readings(alone, "water_track"), readings(every, "water_track"))


def test_two_receivers_alike_have_noise_of_their_own():
    """Of equal tables: uncorrelated within 4 deviations, 2400 readings."""
    twin = {key.replace("gnss.", "sensor.twin."): x for key, x in ON_BOARD.items() if "gnss" in key}
    flight = small_flight(ON_BOARD | twin | {"sensor.twin.kind": "gnss"})
    block, truth = simulate_block(flight, 3, range(20))
    pairs = []
    for run in range(20):
        problem = block.problem(run)
        own, other = (places(problem, sensor) for sensor in ("gnss", "twin"))
        sigma = np.sqrt(np.diag(problem.noise_cov))
        np.testing.assert_array_equal(sigma[own], sigma[other])
        for k in np.flatnonzero(problem.present[:, own[0]]):
            residual = problem.measurements[k] - problem.model.predict(k, truth.error_state[run, k])
            pairs.append(np.stack([residual[own], residual[other]]) / sigma[own])
    one, two = np.concatenate(pairs, axis=1)
    assert abs(np.mean(one * two)) < 4.0 / np.sqrt(len(one))
    assert np.mean((one - two) ** 2) == pytest.approx(2.0, rel=0.15)


def test_two_logs_alike_have_biases_outliers_and_dropouts_of_their_own():
    """Which readings are struck or lost is drawn for each, and so is each bias."""
    log = {key: x for key, x in ON_BOARD.items() if key.startswith("velocity_log")}
    log |= {"velocity_log.period_s": 0.5}
    struck = {"dropout_share": 0.5, "outlier_share": 0.5, "outlier_mps": 1e6}
    faults = {f"truth.velocity_log.{key}": x for key, x in struck.items()}
    twin = {key.replace("velocity_log", "sensor.twin"): x for key, x in (log | faults).items()} | {
        "sensor.twin.kind": "velocity_log"
    }
    problem, truth = simulate(small_flight(log | faults | twin), 1, 0)
    blocks = {block.name: truth.error_state[:, block.slice] for block in problem.layout}
    apart = np.abs(blocks["velocity log bias"] - blocks["twin bias"])
    assert (apart > 1e-6).all()
    own, other = (places(problem, sensor) for sensor in ("velocity_log", "twin"))
    there = problem.present[:, [own[0], other[0]]]
    assert 5 <= np.count_nonzero(there[:, 0] != there[:, 1]) <= 35
    both = there.all(axis=1)
    far = np.abs(problem.measurements[both]) > 1e3
    assert (far[:, own] != far[:, other]).any()


# What each side knows, and what strikes readings.


def test_each_side_may_know_a_named_sensor_otherwise():
    """Noise and biases of each side are its own; the other sensors of the kind stay as they are."""
    changes = {
        "truth.sensor.stern.position_noise_m": 50.0,
        "model.sensor.water_track.bias_mps": 0.0,
        "truth.sensor.sea_level.bias_m": 20.0,
    }
    flight = small_flight(ON_BOARD | SEVERAL | changes)
    problem, truth = simulate(flight, 1, 0)
    assert flight.true.dimension == problem.dimension + 2 == truth.error_state.shape[1] + 2
    sensors = {
        side: {s.name: s for s in getattr(flight, side).aiding} for side in ("true", "model")
    }
    assert sensors["true"]["stern"].noise == (50.0,) * 3
    assert sensors["model"]["stern"].noise == (2.0,) * 3
    assert sensors["true"]["gnss"].noise == sensors["model"]["gnss"].noise
    assert [sensors[side]["sea_level"].bias for side in sensors] == [20.0, 2.0]
    assert [sensors[side]["barometer"].bias for side in sensors] == [5.0, 5.0]
    at = places(problem, "stern")[0]
    there = problem.present[:, at]
    errors = problem.measurements[there, at] + truth.error_state[there, 0]
    assert 20.0 < errors.std() < 100.0
    assert problem.noise_cov[at, at] == 4.0


def test_faults_strike_the_sensor_whose_they_are():
    """Outages, dropouts and outliers of a sensor leave the other of its kind alone."""
    faults = {
        "truth.sensor.stern.dropouts_s": [[5.0, 9.0]],
        "truth.sensor.sea_level.dropout_share": 0.5,
        "truth.sensor.water_track.outlier_share": 0.5,
        "truth.sensor.water_track.outlier_mps": 100.0,
    }
    plain, _ = simulate(small_flight(ON_BOARD | SEVERAL), 1, 0)
    flight = small_flight(ON_BOARD | SEVERAL | faults)
    struck, _ = simulate(flight, 1, 0)
    for sensor in ("gradiometer", *KINDS[:3], "bow_2"):
        np.testing.assert_array_equal(readings(plain, sensor), readings(struck, sensor))
    outage = (plain.times >= 5.0) & (plain.times <= 9.0)
    there = struck.present[:, places(struck, "stern")[0]]
    assert not there[outage].any()
    assert np.array_equal(there[~outage], plain.present[~outage, places(plain, "stern")[0]])
    assert 2 <= len(readings(struck, "sea_level")) < len(readings(plain, "sea_level"))
    off = readings(struck, "water_track") - readings(plain, "water_track")
    assert 0.2 < np.mean(np.abs(off) > 5.0) < 0.8
    at = places(struck, "sea_level")[0]
    assert set(flight.expected[:, at]) == {0.0, 0.5}
    assert set(flight.expected[:, places(struck, "barometer")[0]]) == {1.0}


def test_the_share_of_runs_with_any_reading_is_that_of_independent_sensors():
    """Two of a kind that drop out with 0.3 and 0.5 both do so with 0.15; a third is read between.

    The mean of 200 runs is within 4 deviations of it.
    """
    changes: dict[str, object] = {"gradiometer": None}
    for name, period, share in (("a", 2.0, 0.3), ("b", 2.0, 0.5), ("c", 1.5, 0.0)):
        of = f"sensor.{name}"
        changes |= {f"{of}.kind": "barometer", f"{of}.period_s": period, f"{of}.noise_m": 1.0}
        changes |= {f"truth.{of}.dropout_share": share}
    flight = small_flight(changes)
    found = records.shared_arrays(flight, 1, [])["present"]
    alone = np.abs(np.round(flight.times / 1.5) * 1.5 - flight.times) > 1e-9
    assert set(found[~alone]) == {1.0}
    np.testing.assert_allclose(found[alone], 0.85, rtol=1e-12)
    block, _ = simulate_block(flight, 3, range(200))
    there = np.mean([block.problem(r).present[alone].any(axis=1) for r in range(200)])
    assert abs(there - 0.85) < 4.0 * np.sqrt(0.15 * 0.85 / (200 * np.count_nonzero(alone)))


def test_two_receivers_alike_are_worth_one_of_less_noise():
    """The bound of two of σ is that of one of σ/√2, to rounding; both are better than one."""
    own = {key: x for key, x in ON_BOARD.items() if key.startswith("gnss")}
    twin = {key.replace("gnss", "sensor.twin"): x for key, x in own.items()}
    better = {key: x / np.sqrt(2.0) for key, x in own.items() if "noise" in key}
    two = flight_bound(small_flight(own | twin | {"sensor.twin.kind": "gnss"}))
    one = flight_bound(small_flight(own | better))
    for found, expected in ((two.filtering, one.filtering), (two.smoothing, one.smoothing)):
        sigma = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
        apart = (found - expected) / (sigma[:, :, None] * sigma[:, None, :])
        assert np.abs(apart).max() < 1e-9
    alone = flight_bound(small_flight(own))
    assert (
        np.trace(alone.filtering[:, :3, :3], axis1=1, axis2=2)
        > 1.1 * np.trace(two.filtering[:, :3, :3], axis1=1, axis2=2)
    ).all()


# The file.


def test_a_case_and_a_sweep_change_named_sensors_by_dotted_keys():
    """As they change any table; a case may also be the one that takes a sensor on board."""
    text = SMALL + ('[sensor.stern]\nkind = "gnss"\nperiod_s = 2.0\nposition_noise_m = 2.0\n')
    document = tomllib.loads(text)
    document["case"][1]["sensor"] = {
        "stern": {"position_noise_m": 3.0},
        "bow": {"kind": "barometer", "period_s": 1.0, "noise_m": 1.0},
    }
    first, second = scenario.parse(document, "small", "small").cases[:2]
    assert first.sensor["stern"].position_noise_m == 2.0
    assert second.sensor["stern"].position_noise_m == 3.0
    assert list(second.sensor) == ["bow", "stern"]
    document = tomllib.loads(text)
    axis = {"name": "noise", "label": "noise", "values": [1.0, 4.0]}
    for key in ("sensor.stern.position_noise_m", "model.sensor.stern.position_noise_m"):
        document["sweep"] = {"axis": [axis | {"key": key}]}
        swept = scenario.parse(dict(document), "small", "small").cases[:2]
        found = [case.side("model").sensor["stern"].position_noise_m for case in swept]
        assert found == [1.0, 4.0]


def test_a_case_with_named_sensors_is_the_same_whatever_way_it_is_written():
    """Order, defaults written out, and what a side changes in nothing make no other case."""
    case = small_case(SEVERAL)
    other = small_case(
        dict(reversed(SEVERAL.items()))
        | {"sensor.bow_2.position_noise_m": 1.0, "truth.sensor.stern.dropout_share": 0.0}
    )
    assert other != case  # a position besides
    same = small_case(
        dict(reversed(SEVERAL.items()))
        | {
            "sensor.sea_level.bias_m": 2,
            "sensor.water_track.components": ["x", "y"],
            "truth.sensor.stern.dropout_share": 0.0,
        }
    )
    assert (same, hash(same), same.content_hash) == (case, hash(case), case.content_hash)
    assert checked(case) == case
    assert case.content_hash != small_case().content_hash
    hashes = {
        small_case(SEVERAL | {key: value}).content_hash
        for key, value in (
            ("sensor.stern.position_noise_m", 2.5),
            ("truth.sensor.stern.position_noise_m", 2.5),
            ("model.sensor.stern.position_noise_m", 2.5),
        )
    }
    assert len({case.content_hash, *hashes}) == 4


def in_long_form(changes: dict[str, object]) -> dict[str, object]:
    """Dotted changes with each ``[gnss]`` and its like written as ``[sensor.gnss]``."""
    kinds = "|".join(KINDS)
    return {
        re.sub(rf"^(truth\.|model\.)?({kinds})\.", r"\1sensor.\2.", key): value
        for key, value in changes.items()
    } | {
        f"sensor.{kind}.kind": kind
        for kind in KINDS
        if any(key.startswith(f"{kind}.") for key in changes)
    }


SHORT = ON_BOARD | {
    "truth.gnss.dropouts_s": [[5.0, 9.0]],
    "model.barometer.bias_m": 0.0,
    "truth.sensor.stern.position_noise_m": 50.0,
}


def test_the_table_of_a_kind_is_short_for_a_named_sensor():
    """Equal cases, hashes, keys of stored runs and what is written; short and long may be mixed."""
    case = small_case(SHORT | SEVERAL)
    long = in_long_form(SHORT | SEVERAL)
    assert "gnss" not in {key.partition(".")[0] for key in long}
    mixed = in_long_form({key: x for key, x in SHORT.items() if "gnss" in key})
    mixed |= {key: x for key, x in (SHORT | SEVERAL).items() if "gnss" not in key}
    stern = {key: x for key, x in SEVERAL.items() if "stern" in key}
    for other in (small_case(long), small_case(mixed | stern)):
        assert (other, hash(other), other.content_hash) == (case, hash(case), case.content_hash)
        written = other.model_dump(exclude_none=True)
        assert {"gnss", "velocity_log", "barometer"} < written.keys()
        assert set(written["sensor"]) == set(NAMES)
        assert set(written["truth"]) > {"gnss", "sensor"}
    assert list(case.sensor) == [*KINDS[:3], *NAMES]
    assert checked(case) == case


@pytest.mark.parametrize("of_base", ["gnss", "sensor.gnss"])
@pytest.mark.parametrize("of_change", ["gnss", "sensor.gnss"])
def test_a_change_may_be_written_in_either_form(of_base, of_change):
    """Of cases, sides, axes of sweeps and cases in Python."""
    kind = {"kind": "gnss"} if of_base.startswith("sensor") else {}
    table = kind | {"period_s": 2.0, "position_noise_m": 2.0}
    document = merged(tomllib.loads(SMALL), nested(of_base, table))
    first, second = document["case"][:2]
    document["case"] = [first, merged(second, nested(of_change, {"position_noise_m": 3.0}))]
    document["model"] = nested(of_change, {"position_noise_m": 9.0})
    one, other = scenario.parse(dict(document), "small", "small").cases
    assert [case.sensor["gnss"].position_noise_m for case in (one, other)] == [2.0, 3.0]
    assert other.side("model").sensor["gnss"].position_noise_m == 9.0
    changed = one.changed(f"{of_change}.position_noise_m", 4.0)
    assert changed.sensor["gnss"].position_noise_m == 4.0
    assert one.changed(f"truth.{of_change}.dropout_share", 0.5).truth.sensor["gnss"]
    assert not small_case({of_base: table}).changed(of_change, None).sensor
    axis = {"name": "noise", "label": "noise", "values": [1.0, 4.0]}
    for side in ("", "truth."):
        key = f"{side}{of_change}.position_noise_m"
        document["sweep"] = {"axis": [axis | {"key": key}]}
        swept = scenario.parse(dict(document), "small", "small").cases[:2]
        found = [case.side("truth").sensor["gnss"].position_noise_m for case in swept]
        assert found == [1.0, 4.0]
    again = {"name": "again", "label": "again", "values": [1.0, 2.0]}
    document["sweep"]["axis"] += [again | {"key": f"truth.{of_base}.position_noise_m"}]
    with pytest.raises(GGBenchError, match=r"both change truth\.gnss\.position_noise_m"):
        scenario.parse(document, "small", "small")


def test_the_keys_of_a_named_sensor_tell_its_kind():
    """The identity of a case has no kinds: no table of one kind may be a table of another."""
    for one, other in itertools.combinations(get_args(AidingSpec), 2):
        keys = one.model_fields.keys() & other.model_fields.keys()
        needed = {
            key
            for kind in (one, other)
            for key, field in kind.model_fields.items()
            if field.is_required()
        }
        assert not needed <= keys, (one, other)


def test_names_of_tables_and_states_are_taken():
    """Every table of a case and of a recorded flight: a sensor's file is called by its name."""
    tables = {*CaseSpec.model_fields, *FlightSpec.model_fields}
    assert tables <= RESERVED
    states = {block.name.removesuffix(" bias") for block in small_flight().model.layout}
    assert {name for name in states if " " not in name} <= RESERVED


def test_unusual_values_and_situations_are_those_of_named_sensors_too():
    odd = small_case(SEVERAL | {"sensor.water_track.noise_mps": 50.0})
    assert [key for key, *_ in unusual_in(odd)] == ["sensor.water_track.noise_mps"]
    for sensor, situation in (("stern", "outage"), ("sea_level", "readings")):
        case = small_case(SEVERAL | {f"truth.sensor.{sensor}.dropout_share": 0.5})
        assert situations.situation_of(case) == situation
