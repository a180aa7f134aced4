"""Linear test problems with known solutions, and textbook recursions that compute the solutions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..gravity.ellipsoid import metres_per_radian
from ..gravity.field import Field
from ..problem import Estimate, Problem, StateBlock
from ..sensors.gradiometer.instrument import LOCAL_LEVEL
from ..sensors.model import SensorModel
from ..sensors.model_arrays import ModelArrays


@dataclass(frozen=True)
class LinearModel:
    """Linear measurement model, h(k, x) = H_k x."""

    rows: np.ndarray

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H_k x (..., m) at states x (..., n)."""
        return np.asarray(x) @ self.rows[k].T

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        """Return H_k (..., m, n) at states x (..., n)."""
        return np.tile(self.rows[k], (*np.shape(x)[:-1], 1, 1))


UNITS = np.array([1e3, 1e-2, 1e-6, 1e-8, 1e2])
"""Sizes of the states of :func:`linear_problem`: 1 km, 1 cm/s, 1 µrad, ..."""
CONSTANT = slice(3, 5)
"""States of :func:`linear_problem` that are constant."""


def linear_problem(seed: int, epochs: int = 40, m: int = 2, period: float = 1.0) -> Problem:
    """Return a random linear-Gaussian problem with five states in units of different size.

    Three states change. They are driven by process noise of rank two (an exactly singular Q) and by
    the other two states, which are constant. ``epochs`` is the number K of epochs, ``m`` the number
    of channels, and ``period`` the time between epochs [s].
    """
    rng = np.random.default_rng(seed)
    n = len(UNITS)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    transition = np.tile(np.eye(n), (epochs, 1, 1))
    process_cov = np.zeros((epochs, n, n))
    for k in range(epochs):
        transition[k, :3, :3] = 0.97 * turn + 0.02 * rng.normal(size=(3, 3))
        transition[k, :3, CONSTANT] = 0.1 * rng.normal(size=(3, 2))
        spread = 0.2 * rng.normal(size=(2, 2))
        process_cov[k, :2, :2] = spread @ spread.T
    root = np.eye(n) + 0.3 * np.tril(rng.normal(size=(n, n)), -1)
    rows = rng.normal(size=(epochs, m, n))
    noise_root = np.diag(np.geomspace(0.3, 1.0, m)) + 0.1 * np.tril(np.ones((m, m)), -1)
    mean = rng.normal(size=n)
    x = mean + root @ rng.standard_normal(n)
    measurements = np.empty((epochs, m))
    for k in range(epochs):
        x = transition[k] @ x
        x[:2] += np.linalg.cholesky(process_cov[k, :2, :2]) @ rng.standard_normal(2)
        measurements[k] = rows[k] @ x + noise_root @ rng.standard_normal(m)
    sizes = np.outer(UNITS, UNITS)
    return Problem(
        times=period * np.arange(1, epochs + 1),
        measurements=measurements,
        noise_cov=noise_root @ noise_root.T,
        transition=transition * UNITS[:, None] / UNITS,
        process_cov=process_cov * sizes,
        prior_mean=mean * UNITS,
        prior_cov=root @ root.T * sizes,
        model=LinearModel(rows / UNITS),
        layout=(StateBlock("moving", slice(0, 3), "mixed"), StateBlock("constant", CONSTANT, "1")),
    )


def noisy_problem(seed: int, epochs: int = 40, n: int = 3, m: int = 2) -> Problem:
    """Return a random linear-Gaussian problem with full-rank process noise, for samplers.

    The states decorrelate within a few epochs. A measurement and a prediction are about equally
    precise. ``epochs``, ``n`` and ``m`` are the numbers of epochs, states and channels.
    """
    rng = np.random.default_rng(seed)
    transition, process_cov = np.empty((epochs, n, n)), np.empty((epochs, n, n))
    rows = rng.normal(size=(epochs, m, n))
    for k in range(epochs):
        turn, _ = np.linalg.qr(rng.normal(size=(n, n)))
        transition[k] = 0.9 * turn
        spread = 0.5 * np.eye(n) + 0.1 * rng.normal(size=(n, n))
        process_cov[k] = spread @ spread.T
    x, measurements = rng.normal(size=n), np.empty((epochs, m))
    for k in range(epochs):
        x = transition[k] @ x + np.linalg.cholesky(process_cov[k]) @ rng.normal(size=n)
        measurements[k] = rows[k] @ x + rng.normal(size=m)
    return Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=measurements,
        noise_cov=np.eye(m),
        transition=transition,
        process_cov=process_cov,
        prior_mean=np.zeros(n),
        prior_cov=np.eye(n),
        model=LinearModel(rows),
        layout=(StateBlock("position", slice(0, n), "m"),),
    )


def graded(problem: Problem) -> Problem:
    """Return the problem with R multiplied by a different factor, 1/9 to 9, at each epoch."""
    factors = 9.0 ** np.sin(np.arange(1.0, problem.epochs + 1.0))
    return replace(problem, noise_cov=problem.noise_cov * factors[:, None, None])


def gappy(problem: Problem) -> Problem:
    """Return a problem with some measurements removed.

    Every third measurement of the last channel is missing. The fifth to tenth measurements of all
    channels are also missing. The correlation of the noise between channels is removed.
    """
    present = np.ones(problem.measurements.shape, dtype=bool)
    present[::3, -1] = False
    present[4:10] = False
    model = problem.model
    assert isinstance(model, LinearModel)
    return replace(
        problem,
        measurements=np.where(present, problem.measurements, 0.0),
        noise_cov=np.diag(np.diag(problem.noise_cov)),
        model=LinearModel(model.rows * present[:, :, np.newaxis]),
        present=present,
    )


_SLOPES = np.array([[1.0, 0.5, -0.25], [-0.5, 1.0, 0.75]])
"""Change of the map's Γ_EN and Γ_EU for a metre to the east, north and up [E/m]."""
_REACH = 2e3
"""Distance from the middle of the map to its border [m], within which its field is linear."""


def with_sensor_model(problem: Problem) -> Problem:
    """Replace the :class:`LinearModel` of a problem by the package's sensor model.

    The channels are Γ_EN and Γ_EU, which are zero in the normal field. The map has constant
    derivatives S (m, 3) [E/m] with respect to position, so h(x) = −S B_k x is exactly linear in x.
    B_k (3, n) maps the states to the position error and is chosen such that −S B_k = H_k. The
    problem must have one or two channels.
    """
    model = problem.model
    assert isinstance(model, LinearModel)
    epochs, m, n = model.rows.shape
    metres = np.array([*metres_per_radian(np.zeros(3)), 1.0])  # per radian north and east
    step = 2.0 * _REACH / metres
    nodes = np.stack(np.meshgrid(*(np.arange(4.0) - 1.5,) * 3, indexing="ij"), axis=-1)
    tensor = np.zeros((4, 4, 4, 6))
    tensor[..., 1:3] = 2.0 * _REACH * nodes @ _SLOPES[:, [1, 0, 2]].T  # a spline of one cell
    field = Field(-0.5 * step, step, tensor, np.zeros((4, 4, 4, 3)))
    errors = np.zeros((epochs, 6, n))
    errors[:, :3] = -np.linalg.pinv(_SLOPES[:m]) @ model.rows
    places = np.zeros((epochs, 3))
    arrays = ModelArrays(
        dimension=n,
        instrument=LOCAL_LEVEL,
        channels=np.eye(6)[1 : 1 + m],
        combined=np.eye(6)[np.newaxis, np.newaxis, 1 : 1 + m],
        lags=np.zeros((1, 1), dtype=int),
        origin=field.origin,
        step=field.step,
        coefficients=field.tensor_coefficients,
        base=field.base_coefficients,
        times=problem.times,
        references=places,
        attitudes=np.tile(np.eye(3), (epochs, 1, 1)),
        rows=errors,
        offset=np.zeros((epochs, m)),
        gain=problem.present.any(axis=1).astype(float),
        linear=np.zeros((epochs, m, n)),
        first_linear=m,
        columns=np.zeros(0, dtype=int),
        weights=np.zeros((epochs, m, 3)),
        places=places,
        gravity=field.disturbance_map,
    )
    return replace(problem, model=SensorModel(arrays))


def linear_sensor_problem(seed: int, epochs: int = 40, m: int = 2) -> Problem:
    """Return :func:`linear_problem` with the sensor model that compiled estimators need."""
    return with_sensor_model(linear_problem(seed, epochs, m))


def propagated(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (K, n) and covariance (K, n, n) of the prior, propagated without measurements."""
    means, covs = [], []
    phi = np.eye(problem.dimension)
    noise = np.zeros_like(problem.prior_cov)
    for k in range(problem.epochs):
        phi = problem.transition[k] @ phi
        noise = problem.transition[k] @ noise @ problem.transition[k].T + problem.process_cov[k]
        means.append(phi @ problem.prior_mean)
        covs.append(phi @ problem.prior_cov @ phi.T + noise)
    return np.array(means), np.array(covs)


def kalman(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Run the Kalman filter with the covariance update in Joseph form.

    Return filtered and predicted means (K, n), each with its covariances (K, n, n).
    """
    x, p = problem.prior_mean, problem.prior_cov
    eye = np.eye(problem.dimension)
    out: tuple[list[np.ndarray], ...] = ([], [], [], [])
    for k in range(problem.epochs):
        phi = problem.transition[k]
        x, p = phi @ x, phi @ p @ phi.T + problem.process_cov[k]
        out[2].append(x)
        out[3].append(p)
        h = problem.model.jacobian(k, x)
        s = h @ p @ h.T + problem.noise_of(k)
        gain = np.linalg.solve(s, h @ p).T
        x = x + gain @ (problem.measurements[k] - problem.model.predict(k, x))
        keep = eye - gain @ h
        p = keep @ p @ keep.T + gain @ problem.noise_of(k) @ gain.T
        out[0].append(x)
        out[1].append(p)
    means, covs, predicted, predicted_covs = (np.array(item) for item in out)
    return means, covs, predicted, predicted_covs


def smoothed(problem: Problem, ahead: int) -> tuple[np.ndarray, np.ndarray]:
    """Return smoothed means (K, n) and covariances (K, n, n) by the Rauch–Tung–Striebel smoother.

    The estimate at an epoch uses the measurements up to ``ahead`` epochs later.
    """
    x_f, p_f, x_p, p_p = kalman(problem)
    # The inverse in units of the prior: kilometres and microradians together would spoil it.
    units = np.sqrt(np.diag(problem.prior_cov))
    right = problem.transition[1:] @ p_f[:-1] / units[:, None]
    gains = np.linalg.solve(p_p[1:] / np.outer(units, units), right) / units[:, None]
    means, covs = x_f.copy(), p_f.copy()
    end = problem.epochs - 1
    for last in range(min(ahead, end), end + 1):
        # Back from the end of a window to its start; from the last end, to all windows it ends.
        x, p = x_f[last], p_f[last]
        for j in range(last - 1, max(last - ahead, 0) - 1, -1):
            gain = gains[j].T
            x = x_f[j] + gain @ (x - x_p[j + 1])
            p = p_f[j] + gain @ (p - p_p[j + 1]) @ gain.T
            if last == end or j == last - ahead:
                means[j], covs[j] = x, p
    return means, covs


def exact(problem: Problem, estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Return the exact mean (K, n) and covariance (K, n, n) for the causality of an estimate."""
    if estimate.causality == "none":
        return propagated(problem)
    if estimate.causality == "fixed-lag":
        period = problem.times[-1] - problem.times[-2] if problem.epochs > 1 else 1.0
        return smoothed(problem, int(np.floor((estimate.lag or 0.0) / period + 1e-9)))
    return smoothed(problem, problem.epochs if estimate.causality == "batch" else 0)


def deviation(
    mean: np.ndarray, cov: np.ndarray, true_mean: np.ndarray, true_cov: np.ndarray
) -> tuple[float, float]:
    """Return the largest scaled differences of means (K, n) and of covariances (K, n, n).

    Differences of means are divided by the true standard deviation, those of covariances by the
    product of two true standard deviations.
    """
    sigma = np.sqrt(np.diagonal(true_cov, axis1=1, axis2=2))
    return (
        float(np.max(np.abs(mean - true_mean) / sigma)),
        float(np.max(np.abs(cov - true_cov) / (sigma[:, :, None] * sigma[:, None, :]))),
    )
