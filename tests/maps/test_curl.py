"""Every shipped field has one potential: its tensor is the gradient of its gravity.

The measure is ∇g − T along the flight of a scenario, rms over places and the nine components, over
the rms of T, the disturbing tensor. T is symmetric, so that g has no curl where ∇g is T.

Derivatives are those of the spline. A difference of two places 40 m above and below would leave the
map of parallel_valleys, which ends 30 m below the flight: it shows 9 E where the field has 0.07.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from frame_oracles import metres, square

from ggbench.gravity.ellipsoid import EOTVOS
from ggbench.gravity.field import Field
from ggbench.gravity.spline import vector_at
from ggbench.maps.shipped import SOURCES
from ggbench.simulation.error_free_flight import prepare
from ggbench.simulation.field_source import map_recipe
from ggbench.spec import scenario
from ggbench.spec.case import CaseSpec

PLACES = 100
"""Along a flight."""
LIMIT = 0.01
DAILY = (
    ("ship", "1E"),
    ("wang2013", "0.01E-1Hz"),
)
"""Cases whose maps other daily tests need, too."""


def gradient_of_gravity(field: Field, position: np.ndarray) -> np.ndarray:
    """Return (3, 3) what a step of one metre east, north or up adds to g, in axes that stay [E]."""
    gravity, slope = np.empty(3), np.empty((3, 3))
    vector_at(
        position=position,
        origin=field.origin,
        step=field.step,
        coefficients=field.disturbance_coefficients,
        base=field.base_coefficients,
        value=gravity,
        derivative=slope,
    )
    to_radians = np.linalg.inv(metres(position))
    out = slope @ to_radians
    for axis, (north, east, _) in enumerate(to_radians.T):
        # A step to the east turns the axes about the pole, one to the north about the east.
        turn = [-north, east * np.cos(position[0]), east * np.sin(position[0])]
        out[:, axis] += np.cross(turn, gravity)
    return out / EOTVOS


@functools.cache
def along(name: str, case: str) -> tuple[np.ndarray, np.ndarray]:
    """Return ∇g and T (PLACES, 3, 3) [E] along the flight of a case."""
    flight = prepare(scenario.load(name).case(case))
    track = flight.trajectory.positions
    places = track[np.linspace(0, len(track) - 1, PLACES).astype(int)]
    disturbing = flight.field.tensor(*places.T) - Field.normal().tensor(*places.T)
    found = [gradient_of_gravity(flight.field, place) for place in places]
    return np.array(found), np.array([square(tensor) for tensor in disturbing])


def curl(gradient: np.ndarray, tensor: np.ndarray) -> float:
    """Return the rms of ∇g − T over the rms of T."""
    return float(np.linalg.norm(gradient - tensor) / np.linalg.norm(tensor))


def fields() -> list[tuple[str, str]]:
    """Return a case of every field that a shipped scenario takes for the truth."""
    found = {}
    for name, case in DAILY:
        found[field_of(scenario.load(name).case(case))] = name, case
    for name in scenario.shipped():
        for case in scenario.load(name).cases:
            found.setdefault(field_of(case), (name, case.name))
    return [place for field, place in found.items() if field]


def field_of(case: CaseSpec) -> str:
    """Return what makes a case's map; nothing for the normal field, which has none."""
    field = case.side("truth").field
    return "" if field.source == "normal" else repr(map_recipe(field))


@pytest.mark.parametrize(
    ("name", "case"),
    [
        place if place in DAILY else pytest.param(*place, marks=pytest.mark.long)
        for place in fields()
    ],
)
def test_the_tensor_is_the_gradient_of_the_gravity(name, case):
    """To 1 % (measured: 0.05 to 0.48 %), of a field of 1 E rms or more."""
    gradient, tensor = along(name, case)
    assert curl(gradient, tensor) < LIMIT
    assert np.sqrt(np.mean(tensor**2)) > 1.0


def test_every_source_is_tested():
    """No map that ggbench can build is left out: each source belongs to a shipped field."""
    flown = {scenario.load(name).case(case).field.source for name, case in fields()}
    assert flown == {*SOURCES}


@pytest.mark.parametrize(("name", "case"), DAILY)
@pytest.mark.parametrize("component", [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)])
def test_a_tensor_with_one_component_scaled_has_no_potential(name, case, component):
    """Negative control: a fifth more of any one component exceeds the limit."""
    gradient, tensor = along(name, case)
    scaled = tensor.copy()
    for i, j in {component, component[::-1]}:
        scaled[:, i, j] *= 1.2
    assert curl(gradient, scaled) > LIMIT
