"""The instrument's Butterworth filter, and the two ways to live with it."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest

from ggbench.errors import GGBenchError
from ggbench.sensors.gradiometer.lowpass import LowPass, prefilter

PAPER = LowPass(order=7, cutoff_hz=0.2, rate_hz=1.0)


@pytest.mark.parametrize("order", [1, 2, 7])
@pytest.mark.parametrize("frequency", [0.02, 0.1, 0.2, 0.25, 0.4])
def test_amplitude_is_butterworths(order, frequency):
    """In steady state a sine passes with |H|² = 1/(1 + (tan πf / tan πf_c)^2N) (bilinear)."""
    lowpass = LowPass(order, 0.2, 1.0)
    times = np.arange(6000)
    passed = lowpass.apply(np.exp(2j * np.pi * frequency * times).real)[-1000:]
    quadrature = lowpass.apply(np.exp(2j * np.pi * frequency * times).imag)[-1000:]
    power = (passed**2 + quadrature**2).mean()
    warped = np.tan(np.pi * frequency) / np.tan(np.pi * 0.2)
    assert power == pytest.approx(1.0 / (1.0 + warped ** (2 * order)), rel=1e-6)


def test_rate_scales_the_frequencies():
    """A filter of 2 Hz at 10 Hz is the filter of 0.2 Hz at 1 Hz."""
    samples = np.random.default_rng(1).normal(size=(60, 2))
    np.testing.assert_allclose(
        LowPass(7, 2.0, 10.0).apply(samples), PAPER.apply(samples), rtol=0.0, atol=1e-12
    )


def test_delay_of_a_slow_signal():
    """A ramp comes out 3.093 samples late: the delay at DC of order 7, 0.2 Hz at 1 Hz."""
    ramp = np.arange(400.0)
    late = ramp - PAPER.apply(ramp)
    assert late[-1] == pytest.approx(3.093, abs=5e-4)


def test_share_of_white_noise_that_passes():
    """0.401 of the variance of white noise passes: the energy of the impulse response."""
    impulse = np.zeros(600)
    impulse[100] = 1.0
    assert (PAPER.apply(impulse) ** 2).sum() == pytest.approx(0.401, abs=5e-4)


def test_first_outputs_equal_the_inputs():
    """The instrument starts with as many unfiltered readings as the filter has poles."""
    samples = np.random.default_rng(2).normal(size=(40, 6))
    filtered = PAPER.apply(samples)
    np.testing.assert_array_equal(filtered[:7], samples[:7])
    assert (np.abs(filtered[7] - samples[7]) > 1e-3).all()
    for count in (1, 3, 7):
        np.testing.assert_array_equal(PAPER.apply(samples[:count]), samples[:count])


@pytest.mark.parametrize("order", [1, 2, 7])
def test_the_difference_equation_runs_on_from_the_first_outputs(order):
    """From output N on: sum a_j y_{n-j} = sum b_j x_{n-j}, eq. 3, with the first outputs as past.

    The coefficients from the poles of the analogue prototype, by hand: bilinear transform of
    1/prod(1 - s/p_k), p_k = w exp(iπ(2k+N+1)/(2N)).
    """
    x = np.random.default_rng(3).normal(size=40)
    poles = np.tan(np.pi * 0.2) * np.exp(
        1j * np.pi * (2 * np.arange(order) + order + 1) / (2 * order)
    )
    a = np.poly((1.0 + poles) / (1.0 - poles)).real
    b = np.poly(np.full(order, -1.0))
    b *= a.sum() / b.sum()
    expected = x.copy()
    for n in range(order, len(x)):
        past = slice(n - order, n)
        expected[n] = b @ x[n - order : n + 1][::-1] - a[1:] @ expected[past][::-1]
    np.testing.assert_allclose(LowPass(order, 0.2, 1.0).apply(x), expected, rtol=0.0, atol=1e-11)


def test_a_constant_passes_from_the_start():
    """There is no transient at start-up: a constant field reads as it is."""
    np.testing.assert_allclose(PAPER.apply(np.full((50, 6), -1535.0)), -1535.0, rtol=1e-12)


def test_filter_is_causal_linear_and_per_component():
    """No output knows the future, and components do not mix."""
    rng = np.random.default_rng(4)
    samples = rng.normal(size=(60, 3))
    changed = samples.copy()
    changed[30:, 1] += 1.0
    before, after = PAPER.apply(samples), PAPER.apply(changed)
    np.testing.assert_array_equal(before[:30], after[:30])
    np.testing.assert_array_equal(before[:, [0, 2]], after[:, [0, 2]])
    np.testing.assert_allclose(
        PAPER.apply(2.0 * samples - changed), 2.0 * before - after, rtol=0.0, atol=1e-12
    )


# What can be computed.

PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494")


def sine(x: Decimal) -> Decimal:
    return sum(
        ((-1) ** k * x ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(24)), PI * 0
    )


def product(one: list[Decimal], other: list[Decimal]) -> list[Decimal]:
    """Coefficients of the product of two polynomials."""
    out = [Decimal(0)] * (len(one) + len(other) - 1)
    for i, a in enumerate(one):
        for j, b in enumerate(other):
            out[i + j] += a * b
    return out


def response_of_60_digits(order: int, cutoff: float, count: int) -> np.ndarray:
    """(count, count) what the difference equation of a rate of 1 Hz makes of unit impulses.

    Butterworth's quadratics s² + 2 s sin φ + 1, bilinear transform s = (1 − 1/z)/(1 + 1/z)/w with
    w = tan(π f), in decimal arithmetic.
    """
    with localcontext(prec=60):
        angle = PI * Decimal(cutoff)
        w = sine(angle) / sine(angle + PI / 2)
        a, b = [Decimal(1)], [Decimal(1)]
        for k in range(order // 2):
            damping = 2 * w * sine(PI * (2 * k + 1) / (2 * order))
            a = product(a, [1 + damping + w * w, 2 * w * w - 2, 1 - damping + w * w])
            b = product(b, [w * w, 2 * w * w, w * w])
        if order % 2:
            a, b = product(a, [1 + w, w - 1]), product(b, [w, w])
        out = np.zeros((count, count))
        for column in range(min(order + 1, count)):
            x = [Decimal(int(row == column)) for row in range(count)]
            y = x.copy()
            for n in range(order, count):
                past = sum(a[lag] * y[n - lag] for lag in range(1, order + 1))
                y[n] = (sum(b[lag] * x[n - lag] for lag in range(order + 1)) - past) / a[0]
            out[:, column] = [float(value) for value in y]
    for column in range(order + 1, count):  # no later one knows of the start
        out[column:, column] = out[order : order + count - column, order]
    return out


@pytest.mark.parametrize("order", [1, 3, 5, 7, 9, 12])
def test_what_is_accepted_is_computed_and_nothing_else_is_refused(order):
    """Against 60 digits: what passes is right to 1e-9 of the largest response, whatever its size.

    A filter that is refused for rounding really loses digits: more than three of the sixteen.
    """
    accepted = refused = 0
    for cutoff in (0.003, 0.02, 0.1, 0.2, 0.4, 0.45, 0.49):
        lowpass, count = LowPass(order, cutoff, 1.0), 50
        exact = response_of_60_digits(order, cutoff, count)
        error = np.abs(lowpass.apply(np.eye(count)) - exact).max() / np.abs(exact).max()
        try:
            prefilter(lowpass, count, "whitened", 1e-2)
        except GGBenchError:
            refused += 1
            assert error > 1e-12, cutoff
        else:
            accepted += 1
            assert error < 1e-9, cutoff
    assert accepted >= 3
    assert refused >= (1 if order > 5 else 0)


@pytest.mark.parametrize("cutoff", [0.1, 0.4])
@pytest.mark.parametrize("treatment", ["whitened", "delayed"])
def test_a_large_transient_is_no_rounding(cutoff, treatment):
    """Order 7 far from a fifth of the rate answers its first outputs with tens of them: it may.

    Whatever the treatment makes of it has no more noise than is claimed, and sees the state at an
    instant that the flight has had: an output that extrapolates counts as one of its own time, or
    of the first.
    """
    lowpass, count = LowPass(7, cutoff, 1.0), 60
    response = lowpass.apply(np.eye(count))
    assert np.abs(response).max() > 30.0
    treated = prefilter(lowpass, count, treatment, 1e-2)
    chain = treated.apply(response)
    assert (np.linalg.norm(chain, axis=1) < 1.0 + 1e-6).all()
    seen = chain @ np.arange(count) / chain.sum(axis=1)
    at = np.arange(count) - treated.delay_samples
    inside = (seen >= 0.0) & (seen <= np.arange(count))
    np.testing.assert_allclose(at[inside], seen[inside], atol=1e-6)
    np.testing.assert_allclose(at[seen < 0.0], 0.0, atol=1e-9)
    np.testing.assert_array_equal(treated.delay_samples[seen > np.arange(count)], 0.0)
    if (cutoff, treatment) == (0.4, "delayed"):
        assert (seen > np.arange(count) + 1.0).any()
        assert (seen < -1.0).any()


@pytest.mark.parametrize(("order", "cutoff"), [(12, 0.01), (12, 0.49), (9, 0.01), (7, 0.003)])
def test_a_filter_that_rounding_would_spoil_is_refused(order, cutoff):
    """The message says what is lost, and the way out."""
    with pytest.raises(GGBenchError, match=r"rounding errors may reach .* of its response") as info:
        prefilter(LowPass(order, cutoff, 1.0), 200, "whitened", 1e-2)
    assert str(info.value).startswith(f"the low-pass of order {order} at {cutoff:g} Hz")
    assert "the Nyquist frequency, 0.5 Hz" in str(info.value)


# Treatments.


@pytest.mark.parametrize(
    ("count", "rho"),
    [(count, rho) for count in (5, 8, 60, 200) for rho in (1e-6, 1e-2)] + [(730, 1e-2)],
)
def test_whitened_noise_is_white(count, rho):
    """A y has noise of unit covariance: W Wᵀ + ρ² A Aᵀ = I, for white noise in front of the filter.

    The noise ρ behind the filter is the regularisation; in front of it alone W Wᵀ is I but for
    the directions that the filter kills. What rounding a near-inverse costs is 4e-6.
    """
    treatment = prefilter(PAPER, count, "whitened", rho)
    matrix, chain = (treatment.apply(x) for x in (np.eye(count), PAPER.apply(np.eye(count))))
    total = chain @ chain.T + rho**2 * matrix @ matrix.T
    np.testing.assert_allclose(total, np.eye(count), rtol=0.0, atol=1e-5)
    np.testing.assert_array_equal(np.triu(matrix, 1), 0.0)  # causal


@pytest.mark.parametrize("kind", ["whitened", "delayed"])
@pytest.mark.parametrize(("count", "rho"), [(120, 1e-6), (730, 1e-2)])
def test_gain_and_delay_describe_a_slow_ramp(kind, count, rho):
    """The ramp a + b t comes out of filter and treatment as g (a + b (t − τ)), exactly.

    Delays are floored at zero, where the treatment of the first outputs is a little early.
    """
    treatment = prefilter(PAPER, count, kind, rho)
    times = np.arange(float(count))
    ramp = 5.0 + 0.3 * times
    passed = treatment.apply(PAPER.apply(ramp))
    expected = treatment.gain * (5.0 + 0.3 * (times - treatment.delay_samples))
    floored = treatment.delay_samples == 0.0
    np.testing.assert_allclose(passed[~floored], expected[~floored], rtol=0.0, atol=1e-6)
    assert np.abs(passed - expected)[floored].max(initial=0.0) < 0.3 * 0.01
    assert (treatment.delay_samples >= 0.0).all()
    assert (treatment.delay_samples <= times).all()


def test_delayed_treatment_settles_at_the_delay_at_dc():
    """Left alone, the output is late by the filter's delay and has gain one."""
    treatment = prefilter(PAPER, 120, "delayed", 1e-6)
    output = np.random.default_rng(1).normal(size=(120, 2))
    np.testing.assert_array_equal(treatment.apply(output)[14:], output[14:])
    ramp = np.arange(400.0)
    late = (ramp - PAPER.apply(ramp))[-1]
    assert treatment.delay_samples[-1] == pytest.approx(late, abs=1e-6)
    assert treatment.gain[-1] == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(treatment.delay_samples[:7], 0.0, atol=1e-12)


def test_whitened_treatment_all_but_undoes_the_delay():
    """The filter's information is all there: less than half a sample of delay remains, no loss.

    The information about a constant, gᵀ g, is that of unfiltered readings.
    """
    treatment = prefilter(PAPER, 200, "whitened", 1e-6)
    assert treatment.delay_samples.max() < 0.5
    assert (treatment.gain**2).sum() == pytest.approx(200.0, rel=0.01)


@pytest.mark.parametrize("kind", ["whitened", "delayed"])
def test_a_long_flight_is_treated_as_a_short_one_goes_on(kind):
    """Once the start is forgotten an output is treated as the one before it, moved by one.

    What it takes does not grow with the flight, and the first outputs do not know how long it is.
    """
    short, long = (prefilter(PAPER, count, kind, 1e-2) for count in (600, 4000))
    output = np.random.default_rng(2).normal(size=(2, 4000, 3))
    np.testing.assert_allclose(
        long.apply(output)[:, :600], short.apply(output[:, :600]), rtol=0.0, atol=1e-12
    )
    moved = np.roll(output, -1, axis=1)
    np.testing.assert_allclose(
        long.apply(moved)[:, 1000:-1], long.apply(output)[:, 1001:], rtol=0.0, atol=1e-12
    )
    assert long.matrix.size + long.later.size <= short.matrix.size + short.later.size


def test_no_filter_needs_no_treatment():
    treatment = prefilter(None, 30, "whitened", 1e-6)
    output = np.random.default_rng(1).normal(size=(30, 2))
    np.testing.assert_array_equal(treatment.apply(output), output)
    np.testing.assert_array_equal(treatment.gain, 1.0)
    np.testing.assert_array_equal(treatment.delay_samples, 0.0)
