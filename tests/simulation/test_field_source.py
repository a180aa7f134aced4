"""The fields of a case: from which maps, where they must be, how a map is made wrong."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import numpy as np
import pytest
from small_cases import blank_map, rough_map, small_case

from ggbench.campaign.flights import case_bounds, first_problem, flight_of
from ggbench.campaign.result_keys import run_key
from ggbench.gravity.field import OutsideMapError
from ggbench.judging.references import CaseBound
from ggbench.maps.recipe import read, write
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.field_source import make_field
from ggbench.simulation.flight_bounds import flight_bound
from ggbench.spec.sensors import FieldSpec, MapErrorSpec


def test_the_estimators_map_must_hold_the_flight(tmp_path):
    """The truth may have no map at all; what the estimators compare with must be there."""
    there = rough_map(tmp_path / "map.nc")
    prepare(small_case({"model.field.source": there}))
    with pytest.raises(OutsideMapError, match=r"33\.\d+° N, 108\.\d+° E, 10000 m is outside"):
        prepare(small_case({"model.field.source": there, "trajectory.longitude_deg": 108.2}))


def test_a_map_that_is_written_anew_is_read_anew(tmp_path):
    """Within one process, a notebook say: by the time of the file."""
    path = Path(rough_map(tmp_path / "map.nc", seed=1))
    before = make_field(FieldSpec(source=str(path)))
    assert make_field(FieldSpec(source=str(path))) is before
    rough_map(path, seed=2)
    os.utime(path, ns=(path.stat().st_mtime_ns + 10**9,) * 2)
    after = make_field(FieldSpec(source=str(path)))
    assert (after.tensor_coefficients != before.tensor_coefficients).any()


def test_what_is_kept_of_a_case_is_of_the_present_map(tmp_path):
    """Its flight, problem, bound and key; and without a change, all are kept."""
    path = Path(rough_map(tmp_path / "map.nc", rms=10.0))
    case = small_case({"field.source": str(path)})

    def kept():
        (bound,) = case_bounds([case])
        return flight_of(case), first_problem(case, 5), bound, run_key(case, {}, 5)

    before = kept()
    assert all(new is old for new, old in zip(kept()[:3], before[:3], strict=True))
    assert kept()[3] == before[3]
    rough_map(path, rms=30.0)
    os.utime(path, ns=(path.stat().st_mtime_ns + 10**9,) * 2)
    after = kept()
    assert after[0].field.tensor_coefficients == pytest.approx(
        3.0 * before[0].field.tensor_coefficients
    )
    assert (after[1].measurements != before[1].measurements).any()
    assert after[2] is not before[2] and after[3] != before[3]


def test_a_wrong_density_is_a_factor_of_the_whole_disturbing_field(tmp_path):
    """Of the gradients and of the gravity that comes with them."""
    path = rough_map(tmp_path / "map.nc")
    right = make_field(FieldSpec(source=path))
    wrong = make_field(FieldSpec(source=path, error=MapErrorSpec(density_factor=1.25)))
    for name in ("tensor_coefficients", "disturbance_coefficients"):
        values = getattr(right, name)
        difference = getattr(wrong, name) - 1.25 * values
        assert np.abs(difference).max() < 1e-12 * np.abs(values).max()


def test_another_seed_is_another_error_of_the_map(tmp_path):
    path = rough_map(tmp_path / "map.nc")
    one, two = (
        make_field(FieldSpec(source=path, error=MapErrorSpec(white_noise_eotvos=1.0, seed=seed)))
        for seed in (1, 2)
    )
    assert np.abs(one.tensor_coefficients - two.tensor_coefficients).max() > 1.0


def test_a_map_is_kept_once_whether_its_gravity_is_felt_or_not(tmp_path):
    spec = FieldSpec(source=rough_map(tmp_path / "map.nc"))
    assert make_field(spec.model_copy(update={"gravity_disturbance": True})) is make_field(spec)


@pytest.mark.parametrize("turn", [-720.0, -360.0, 360.0])
def test_a_flight_is_over_a_map_in_whatever_turn_its_longitudes_are(turn, tmp_path):
    """What is read, felt and bounded is the same; the flight keeps its own longitudes."""
    felt = {"truth.field.gravity_disturbance": True, "field.source": rough_map(tmp_path / "m.nc")}
    here = prepare(small_case(felt))
    found = dataclasses.replace(
        read(Path(felt["field.source"])), longitude0=here.field.lower[1] + math.radians(turn)
    )
    write(tmp_path / "other.nc", found)
    there = prepare(small_case(felt | {"field.source": str(tmp_path / "other.nc")}))
    np.testing.assert_array_equal(there.trajectory.positions, here.trajectory.positions)
    np.testing.assert_allclose(there.noise_free, here.noise_free, atol=1e-6)
    np.testing.assert_allclose(there.delta_velocities, here.delta_velocities, atol=1e-13)
    ours, theirs = (CaseBound(flight, flight_bound(flight)).final_m for flight in (here, there))
    assert theirs == pytest.approx(ours, rel=1e-6)


def test_a_map_is_cut_across_the_date_line(tmp_path):
    """West of it 179.9°, east of it -179.9°."""
    there = dataclasses.replace(blank_map(), longitude0=math.radians(179.8))
    write(tmp_path / "map.nc", there)
    bounds = {"source": str(tmp_path / "map.nc"), "south_deg": 33.45, "north_deg": 33.55}
    field = make_field(FieldSpec(**bounds, west_deg=179.95, east_deg=-179.95))
    assert np.degrees([field.lower[1], field.upper[1]]) == pytest.approx([180.0, 180.0], abs=0.1)
