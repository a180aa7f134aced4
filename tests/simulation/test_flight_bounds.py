"""Bounds of several flights are computed together, and are those of each alone."""

from __future__ import annotations

import numpy as np
import pytest
from small_cases import rough_map, small_case, small_flight

from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.flight_bounds import bounds, flight_bound
from ggbench.simulation.runs import simulate_flights


def test_bounds_together_are_those_alone():
    """Bit by bit, of ten tracks: more than go through the lanes at once."""
    case = small_case({"draw.tracks": 10, "draw.start_km": 0.5, "draw.heading_deg": 20.0})
    flights = [prepare(case.of_run(run)) for run in range(10)]
    found = bounds(flights)
    for flight, bound in zip(flights, found, strict=True):
        assert np.array_equal(bound.filtering, bounds([flight])[0].filtering)
        assert np.array_equal(bound.smoothing, flight_bound(flight).smoothing)
    assert not np.array_equal(found[0].filtering, found[1].filtering)


@pytest.mark.parametrize(
    "change", [{"gradiometer.period_s": 2.0}, {"field.source": "rough"}], ids=["epochs", "map"]
)
def test_flights_of_other_epochs_or_maps_are_refused(change, rough):
    if "field.source" in change:
        change = {"field.source": rough}
    flights = [small_flight(), small_flight(change)]
    with pytest.raises(ValueError, match="different epochs or maps"):
        bounds(flights)
    with pytest.raises(ValueError, match="different epochs or maps"):
        simulate_flights(flights, 1, [0, 1])


@pytest.fixture(scope="module")
def rough(tmp_path_factory: pytest.TempPathFactory) -> str:
    return rough_map(tmp_path_factory.mktemp("maps") / "map.nc", rms=100.0)
