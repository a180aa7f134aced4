"""A flight through a rough synthetic field: where nonlinearity and bad readings tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ggbench.problem import Problem, StateBlock

LENGTH = 2000.0
"""Correlation length of the field [m]: correlation exp(−d² / (2 LENGTH²))."""
AMPLITUDE = 10.0
"""Standard deviation of each component over the field."""


@dataclass(frozen=True)
class RoughModel:
    """Components of a stationary Gaussian random field (sum of waves) along a track.

    The position is that of the track plus the first d states; waves (·, d), d is mostly 3.
    """

    track: np.ndarray
    waves: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray

    def predict(self, k: int, x: np.ndarray) -> np.ndarray:
        phase = (self.track[k] + np.asarray(x)[..., : self.waves.shape[1]]) @ self.waves.T
        return np.cos(phase) @ self.cosine + np.sin(phase) @ self.sine

    def jacobian(self, k: int, x: np.ndarray) -> np.ndarray:
        x, d = np.asarray(x), self.waves.shape[1]
        phase = (self.track[k] + x[..., :d]) @ self.waves.T
        slope = np.cos(phase)[..., None] * self.sine - np.sin(phase)[..., None] * self.cosine
        rows = np.zeros((*x.shape[:-1], slope.shape[-1], x.shape[-1]))
        rows[..., :d] = np.swapaxes(slope, -1, -2) @ self.waves
        return rows


def rough_flight(
    seed: int,
    sigma: float,
    epochs: int = 100,
    m: int = 6,
    noise: float = 0.1,
    claimed: float | None = None,
    outliers: float = 0.0,
    vertical: float = 20.0,
    states: int = 9,
) -> tuple[Problem, np.ndarray]:
    """Return a problem with a prior of ``sigma`` [m] in the horizontal, and its truth (K, n).

    250 m/s to the east, a reading per second. Position, velocity and constant acceleration
    errors, and, beyond nine states, constants that no reading shows. A share ``outliers`` of the
    readings' components is off by about 30 deviations of the noise; ``claimed`` is the noise of
    which the problem tells.
    """
    rng = np.random.default_rng([seed, 17])
    track = np.zeros((epochs, 3))
    track[:, 0] = 250.0 * np.arange(epochs)
    waves = rng.normal(size=(60, 3)) / LENGTH
    scale = AMPLITUDE / np.sqrt(len(waves))
    cosine, sine = scale * rng.normal(size=(2, len(waves), m))
    model = RoughModel(track, waves, cosine, sine)

    step = np.eye(states)
    step[0:3, 3:6] = np.eye(3)
    step[0:3, 6:9] = 0.5 * np.eye(3)
    step[3:6, 6:9] = np.eye(3)
    q = np.zeros((states, states))
    q[3:6, 3:6] = 0.03**2 * np.eye(3)
    q[0:3, 0:3] = q[3:6, 3:6] / 3.0
    q[0:3, 3:6] = q[3:6, 0:3] = q[3:6, 3:6] / 2.0
    prior = np.ones(states)
    prior[:9] = [sigma, sigma, vertical, 0.3, 0.3, 0.3, 0.003, 0.003, 0.003]

    x = prior * rng.standard_normal(states)
    root = np.zeros((states, states))
    root[:6, :6] = np.linalg.cholesky(q[:6, :6])
    truth = np.empty((epochs, states))
    measurements = np.empty((epochs, m))
    for k in range(epochs):
        x = step @ x + root @ rng.standard_normal(states)
        truth[k] = x
        measurements[k] = model.predict(k, x) + noise * rng.standard_normal(m)
    bad = rng.random((epochs, m)) < outliers
    measurements += 30.0 * noise * bad * rng.standard_normal((epochs, m))
    problem = Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=measurements,
        noise_cov=(noise if claimed is None else claimed) ** 2 * np.eye(m),
        transition=np.tile(step, (epochs, 1, 1)),
        process_cov=np.tile(q, (epochs, 1, 1)),
        prior_mean=np.zeros(states),
        prior_cov=np.diag(prior**2),
        model=model,
        layout=(
            StateBlock("position error ENU", slice(0, 3), "m"),
            StateBlock("velocity error ENU", slice(3, 6), "m/s"),
        ),
    )
    return problem, truth


def constant_offset(
    seed: int,
    offset: tuple[float, float, float],
    sigma: float,
    epochs: int = 20,
    m: int = 6,
    noise: float = 0.1,
    vertical: float = 20.0,
    draws: np.random.Generator | None = None,
) -> Problem:
    """Return the same track under an INS that is off by a constant ENU offset [m].

    Three states, the offset, which nothing moves; readings without any error, unless ``draws``
    gives them the noise of which the problem tells.
    """
    model = rough_flight(seed, sigma, epochs=epochs, m=m)[0].model
    read = np.array([model.predict(k, np.array(offset)) for k in range(epochs)])
    if draws is not None:
        read += noise * draws.standard_normal(read.shape)
    return Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=read,
        noise_cov=noise**2 * np.eye(m),
        transition=np.tile(np.eye(3), (epochs, 1, 1)),
        process_cov=np.zeros((epochs, 3, 3)),
        prior_mean=np.zeros(3),
        prior_cov=np.diag([sigma**2, sigma**2, vertical**2]),
        model=model,
        layout=(StateBlock("position error ENU", slice(0, 3), "m"),),
    )


def drifting_position(seed: int, axes: int, sigma: float) -> Problem:
    """Return a problem that a grid solves: a position, and the velocity along its first axis.

    Twenty readings of three components, one a second at 50 m/s, with a noise of 3 in a field of 10
    whose correlation length is 1500 m. The position has a prior of ``sigma`` [m] per axis.
    """
    rng, epochs, m, noise = np.random.default_rng([seed, 31]), 20, 3, 3.0
    track = np.zeros((epochs, axes))
    track[:, 0] = 50.0 * np.arange(epochs)
    waves = rng.normal(size=(60, axes)) / 1500.0
    model = RoughModel(track, waves, *(AMPLITUDE / np.sqrt(60) * rng.normal(size=(2, 60, m))))
    n = axes + 1
    step, q = np.eye(n), 0.01 * np.eye(n)
    step[0, axes] = 1.0
    q[axes, axes] = 1e-4
    prior = np.diag([sigma**2] * axes + [2.0**2])
    x = np.sqrt(np.diag(prior)) * rng.standard_normal(n)
    measurements = np.empty((epochs, m))
    for k in range(epochs):
        x = step @ x + np.sqrt(np.diag(q)) * rng.standard_normal(n)
        measurements[k] = model.predict(k, x) + noise * rng.standard_normal(m)
    return Problem(
        times=np.arange(1.0, epochs + 1.0),
        measurements=measurements,
        noise_cov=noise**2 * np.eye(m),
        transition=np.tile(step, (epochs, 1, 1)),
        process_cov=np.tile(q, (epochs, 1, 1)),
        prior_mean=np.zeros(n),
        prior_cov=prior,
        model=model,
        layout=(
            StateBlock("position error", slice(0, axes), "m"),
            StateBlock("velocity error", slice(axes, n), "m/s"),
        ),
    )
