"""What is wrong with a map is what was asked for, and a harmonic field where that is claimed."""

from __future__ import annotations

import dataclasses
import math
import os

import numpy as np
import pytest
from frame_oracles import metres
from scipy.integrate import quad
from scipy.stats import chi2
from small_cases import blank_map, rough_map, small_case

from ggbench.gravity.degraded_map import MapDegradation, degrade
from ggbench.gravity.field import Field
from ggbench.gravity.gradient_map import GradientMap, MapError
from ggbench.maps.recipe import read
from ggbench.simulation.field_source import make_field

LENGTH = 2000.0
ALONG = {"east": 1, "north": 0}


@pytest.fixture(scope="module")
def plane() -> GradientMap:
    """A map of nothing, 150 km wide."""
    return blank_map(count=160)


@pytest.fixture(scope="module")
def noisy(plane) -> GradientMap:
    """The same with correlated noise of 3 E, 2 km long."""
    return degrade(plane, MapDegradation(correlated_noise_eotvos=3.0, correlation_m=LENGTH, seed=5))


def spacing(grid: GradientMap) -> tuple[float, float]:
    """Distances of the nodes to the north and east [m], at the middle of a map."""
    middle = grid.latitude0 + 0.5 * len(grid.tensor) * grid.latitude_step
    per_radian = metres(np.array([middle, grid.longitude0, grid.height0]))
    return per_radian[1, 0] * grid.latitude_step, per_radian[0, 1] * grid.longitude_step


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


# Correlated noise.


def test_correlated_noise_has_the_stated_size_and_length(plane, noisy):
    """Γ_UU of the lowest layer: RMS 3 E, correlation exp(−d²/ℓ²) to the east and to the north.

    An area of 150 km by 120 km has some 1500 independent patches (π ℓ² and more of each): the RMS
    is known to 2 %, correlations to 0.025; bands of four such deviations.
    """
    vertical = noisy.tensor[:, :, 0, 5]
    assert rms(vertical) == pytest.approx(3.0, rel=0.08)
    for axis, step in enumerate(spacing(plane)):
        for shift in (1, 2, 3, 6):
            here = np.take(vertical, np.arange(160 - shift), axis)
            there = np.take(vertical, np.arange(shift, 160), axis)
            found = np.mean(here * there) / np.mean(vertical**2)
            assert found == pytest.approx(math.exp(-((shift * step / LENGTH) ** 2)), abs=0.1)


def test_correlated_noise_fades_with_height_as_its_wavelengths_do(noisy):
    """Layer by layer the RMS is that of the spectrum exp(−k²ℓ²/4), damped by e^(−kz)."""
    for layer in range(1, 6):
        ratio = rms(noisy.tensor[:, :, layer, 5]) / rms(noisy.tensor[:, :, 0, 5])
        expected = math.sqrt(power(200.0 * layer) / power(0.0))
        assert ratio == pytest.approx(expected, rel=0.03)
    assert ratio < 0.6


def power(height: float) -> float:
    """The variance of the spectrum exp(−k²ℓ²/4), damped by e^(−kz)."""
    return quad(
        lambda k: k * math.exp(-((k * LENGTH) ** 2) / 4.0 - 2.0 * k * height), 0.0, 50.0 / LENGTH
    )[0]


def test_correlated_noise_of_a_draped_map_is_that_of_a_level_one_at_its_heights(plane, noisy):
    """The same field, so scaled that the lowest layer has the stated RMS.

    The base is of steps that lead from layer to layer: 400 m below to 400 m above its mean. An
    area of 1500 patches: the RMS is known to 3 % if the valleys count most; four such deviations.
    """
    steps = np.random.default_rng(2).permutation(np.resize(np.arange(-2, 3), 160 * 160))
    steps = steps.reshape(160, 160)
    low = dataclasses.replace(plane, base=200.0 * steps)
    error = MapDegradation(correlated_noise_eotvos=3.0, correlation_m=LENGTH, seed=5)
    draped = degrade(low, error)
    assert draped.base is low.base
    scale = math.sqrt(power(0.0) / np.mean([power(200.0 * step) for step in range(-2, 3)]))
    assert scale < 0.97
    rows, columns, layers = np.indices((160, 160, 6))
    level = steps[..., np.newaxis] + layers
    known = (level >= 0) & (level < 6)
    assert known.mean() > 0.7
    for name, size in (("tensor", 1e-4), ("gravity_disturbance", 1e-10)):
        expected = scale * getattr(noisy, name)[rows, columns, np.clip(level, 0, 5)]
        np.testing.assert_allclose(getattr(draped, name)[known], expected[known], 0.0, size)
    assert np.abs(draped.tensor[..., [0, 3, 5]].sum(axis=-1)).max() < 1e-9
    assert rms(draped.tensor[:, :, 0, 5]) == pytest.approx(3.0, rel=0.12)
    valleys, summits = (draped.tensor[steps == step, 0, 5] for step in (-2, 2))
    expected = math.sqrt(power(-400.0) / power(400.0))
    assert rms(valleys) / rms(summits) == pytest.approx(expected, rel=0.12)


@pytest.mark.long
def test_correlated_noise_is_the_gradient_of_a_potential(noisy):
    """No trace, and the tensor is the gradient of the gravity vector, symmetric as it stands.

    By differences over 100 m between the nodes, where splines stand for the field: to 1 % rms of
    each component, which a wrong sign, axis or unit misses by far.
    """
    trace = noisy.tensor[..., [0, 3, 5]].sum(axis=-1)
    assert np.abs(trace).max() < 1e-9
    field, normal = Field.from_map(noisy), Field.normal()
    rng = np.random.default_rng(1)
    low, high = field.origin, field.upper
    share = rng.uniform([0.2, 0.2, 0.3], [0.8, 0.8, 0.7], (200, 3))
    points = low + share * (high - low)
    tensor = field.tensor(*points.T) - normal.tensor(*points.T)
    per_radian = metres(points[0])  # alike all over the map, to 1 %
    pairs = {(0, 0): 0, (0, 1): 1, (0, 2): 2, (1, 1): 3, (1, 2): 4, (2, 2): 5}
    for axis in range(3):
        step = np.linalg.solve(per_radian, 50.0 * np.eye(3)[axis])
        ahead, behind = (field.gravity_disturbance(*(points + s * step).T) for s in (1.0, -1.0))
        slope = (ahead - behind) / 100.0 * 1e9
        for other in range(3):
            column = tensor[:, pairs[min(axis, other), max(axis, other)]]
            assert rms(slope[:, other] - column) < 0.03 * rms(column)


def test_the_same_seed_is_the_same_error(plane):
    """Of white and of correlated noise; another seed is another map, in both."""
    for kind in ("white_noise_eotvos", "correlated_noise_eotvos"):
        one, again, other = (
            degrade(plane, MapDegradation(**{kind: 2.0, "seed": seed})).tensor for seed in (1, 1, 2)
        )
        np.testing.assert_array_equal(one, again)
        assert abs(np.mean(one * other)) < 0.3 * np.mean(one**2)


# White noise, density, resolution.


def test_white_noise_is_independent_at_each_node(plane):
    """RMS of each component by chi-square, false-alarm probability 1e-4 each; no correlation.

    Gravity is not touched: what the accelerometers feel does not come from a survey's noise.
    """
    noise = degrade(plane, MapDegradation(white_noise_eotvos=0.5))
    values = noise.tensor.reshape(-1, 6) / 0.5
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], len(values))
    power = (values**2).sum(axis=0)
    assert ((low < power) & (power < high)).all()
    limit = 4.5 / math.sqrt(len(values))
    assert np.abs(np.corrcoef(values.T) - np.eye(6)).max() < limit
    grid = noise.tensor / 0.5
    for axis in range(3):
        a, b = (
            np.take(grid, np.arange(grid.shape[axis])[part], axis)
            for part in (slice(1, None), slice(None, -1))
        )
        assert abs(np.mean(a * b)) < limit
    np.testing.assert_array_equal(noise.gravity_disturbance, 0.0)


def test_a_wrong_density_scales_the_field(noisy):
    """All of the disturbing field, gradient and gravity, and nothing of the normal field."""
    scaled = degrade(noisy, MapDegradation(density_factor=1.1))
    np.testing.assert_allclose(scaled.tensor, 1.1 * noisy.tensor, rtol=1e-14)
    np.testing.assert_allclose(
        scaled.gravity_disturbance, 1.1 * noisy.gravity_disturbance, rtol=1e-14
    )
    assert "density_factor 1.1" in scaled.provenance
    right = degrade(noisy, MapDegradation())
    np.testing.assert_array_equal(right.tensor, noisy.tensor)


@pytest.mark.parametrize("direction", ALONG)
def test_resolution_takes_short_waves_away(plane, direction):
    """A wave of length λ is damped by exp(−(2π σ/λ)²/2), to the east as to the north.

    Waves of 8 and 40 km under a Gaussian of 2 km: to a third, and hardly.
    """
    axis = ALONG[direction]
    step = spacing(plane)[axis]
    nodes = np.arange(160.0)
    for wavelength in (8e3, 40e3):
        wave = np.cos(2.0 * math.pi * nodes * step / wavelength)
        shape = (1, 160, 1, 1) if axis == 1 else (160, 1, 1, 1)
        tensor = plane.tensor + wave.reshape(shape)
        gravity = plane.gravity_disturbance + wave.reshape(shape)
        smooth = degrade(
            dataclasses.replace(plane, tensor=tensor, gravity_disturbance=gravity),
            MapDegradation(resolution_m=2e3),
        )
        left = math.exp(-0.5 * (2.0 * math.pi * 2e3 / wavelength) ** 2)
        inner = slice(20, 140)  # away from the edges
        for found in (smooth.tensor, smooth.gravity_disturbance):
            line = found[80, :, 2, 0] if axis == 1 else found[:, 80, 2, 0]
            np.testing.assert_allclose(line[inner], left * wave[inner], rtol=0.0, atol=2e-3)


def test_noise_is_added_after_the_smoothing(noisy):
    """A survey's noise is not smoothed by what its map does not resolve."""
    smooth = degrade(noisy, MapDegradation(resolution_m=5e3, density_factor=0.9)).tensor
    both = degrade(
        noisy, MapDegradation(resolution_m=5e3, density_factor=0.9, white_noise_eotvos=1.0)
    ).tensor
    alone = degrade(noisy, MapDegradation(white_noise_eotvos=1.0)).tensor - noisy.tensor
    np.testing.assert_allclose(both - smooth, alone, rtol=0.0, atol=1e-9)
    assert rms(smooth) < 0.5 * rms(noisy.tensor)


# In a scenario.


def test_a_scenarios_error_is_that_of_its_map(tmp_path):
    """[field.error] in kilometres and E is the degraded map; the truth keeps the right one."""
    path = rough_map(tmp_path / "rough.nc")
    error = {
        "resolution_km": 2.0,
        "density_factor": 1.2,
        "correlated_noise_eotvos": 1.0,
        "correlation_km": 4.0,
        "seed": 9,
    }
    case = small_case({"field.source": path, "model.field.error": error})
    right, wrong = (make_field(case.side(name).field) for name in ("truth", "model"))
    expected = degrade(
        read(tmp_path / "rough.nc"),
        MapDegradation(2e3, 1.2, 0.0, 1.0, 4e3, 9),
    )
    np.testing.assert_array_equal(
        wrong.tensor_coefficients, Field.from_map(expected).tensor_coefficients
    )
    assert np.abs(wrong.tensor_coefficients - right.tensor_coefficients).max() > 1.0
    np.testing.assert_array_equal(wrong.origin, right.origin)


def test_a_map_that_was_written_anew_is_read_anew(tmp_path):
    """A process that goes on after a map's file has changed does not fly over the old one."""
    path = rough_map(tmp_path / "rough.nc", seed=1)
    spec = small_case({"field.source": path}).field
    first = make_field(spec)
    assert make_field(spec) is first
    rough_map(tmp_path / "rough.nc", seed=2)
    os.utime(path, ns=(1, 1))
    assert np.abs(make_field(spec).tensor_coefficients - first.tensor_coefficients).max() > 1.0


def test_what_is_no_map_has_its_sentence(tmp_path):
    """A file of something else, and the normal field with an error."""
    path = tmp_path / "odd.nc"
    path.write_bytes(b"no map")
    with pytest.raises(MapError, match=r"odd.nc cannot be read as a netCDF file"):
        make_field(small_case({"field.source": str(path)}).field)
    rough = {"field.source": rough_map(tmp_path / "rough.nc")}
    for key, value in (
        ("density_kg_m3", 2000.0),
        ("relief_smoothing_deg", 0.1),
        ("land_correction", False),
    ):
        case = small_case(rough | {f"truth.field.{key}": value})
        with pytest.raises(MapError, match=f"field.{key} is {value}, but .* does not use it"):
            make_field(case.side("truth").field)
    with pytest.raises(MapError, match='source = "normal" has no map'):
        make_field(small_case({"field.error": {"density_factor": 2.0}}).field)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ({"resolution_km": 100.0}, r"resolution_km = 100, .* at most the width of the map, 31 km"),
        (
            {"correlated_noise_eotvos": 1.0, "correlation_km": 0.5},
            r"correlation_km = 0.5, .* at least the node spacing, 0.92\d km",
        ),
        (
            {"correlated_noise_eotvos": 1.0, "correlation_km": 1000.0},
            r"correlation_km = 1000, too long for a node spacing of 0.77\d km",
        ),
    ],
)
def test_lengths_that_do_not_go_with_a_map_are_refused(error, words, tmp_path):
    """Neither hours of filtering nor gigabytes of random numbers, but a sentence."""
    case = small_case({"field.source": rough_map(tmp_path / "a.nc"), "model.field.error": error})
    with pytest.raises(MapError, match=words):
        make_field(case.side("model").field)
