"""EKF and UKF of dynamax (JAX), compiled.

h is written in jax.numpy with the formulas of :mod:`.numpy_model`. JAX differentiates h for the
EKF. Measurements are in units of the noise standard deviation, because dynamax adds 1e-9 to the
diagonal of matrices before their inversion. The precision is double.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from dynamax.nonlinear_gaussian_ssm import (  # noqa: E402
    ParamsNLGSSM,
    UKFHyperParams,
    extended_kalman_filter,
    unscented_kalman_filter,
)

from . import numpy_model as nm  # noqa: E402
from .problem_file import Arrays  # noqa: E402


def reading(arrays: Arrays) -> Callable[..., Any]:
    """Return a function that computes the tensor in inertial axes at a position and a time."""
    normal = nm.NormalField(arrays.even_zonals)
    coefficients = jnp.asarray(arrays.coefficients)
    cells = np.array(arrays.coefficients.shape[:3]) - 3

    def tensor_at(position: Any, time: Any) -> Any:
        u = jnp.clip((position - arrays.origin) / arrays.step, 0.0, cells.astype(float))
        first = jnp.minimum(u.astype(int), cells - 1)
        t = u - first
        weights = nm.WEIGHTS @ jnp.stack([jnp.ones_like(t), t, t * t, t * t * t])
        corner = jax.lax.dynamic_slice(coefficients, (*first, 0), (4, 4, 4, 6))
        found = weights[:, 0] @ corner.reshape(4, 96)
        found = weights[:, 1] @ found.reshape(4, 24)
        tensor = weights[:, 2] @ found.reshape(4, 6)
        latitude, longitude, height = position
        place = nm.geocentric(jnp, latitude, height)
        legendre = normal.legendre[:3] @ powers(place[1], len(normal.powers))
        ratios = powers((nm.SEMI_MAJOR_AXIS / place[0]) ** 2, len(normal.degrees))
        v = (normal.radial[:3] * ratios) @ legendre.T
        v = v * (1.0 / place[0]) * powers(1.0 / place[0], 3)[:, None]
        ee, nn, nu, uu = nm.normal_tensor(v, *place)
        tensor = tensor + nm.PER_EOTVOS * jnp.stack([ee, 0.0, 0.0, nn, nu, uu])
        angle = longitude + nm.ROTATION_RATE * time
        sin_l, cos_l = jnp.sin(latitude), jnp.cos(latitude)
        sin_a, cos_a = jnp.sin(angle), jnp.cos(angle)
        c_in = jnp.stack(
            [-sin_a, -sin_l * cos_a, cos_l * cos_a, cos_a, -sin_l * sin_a, cos_l * sin_a,
             0.0, cos_l, sin_l]
        ).reshape(3, 3)  # fmt: skip
        return (c_in @ tensor[nm.SQUARE] @ c_in.T).ravel()[nm.UPPER]

    return tensor_at


def powers(x: Any, count: int) -> Any:
    """Return 1, x, x², ... from products; ``**`` with an array would use logarithms."""
    return jnp.concatenate([jnp.ones(1), jnp.cumprod(jnp.full(count - 1, x))])


class Ekf:
    """EKF by extended_kalman_filter, jitted, one run per call."""

    runs_per_call = 1
    together = False

    def __init__(self, arrays: Arrays) -> None:
        self.arrays = arrays
        tensor_at = reading(arrays)
        sigma = np.sqrt(np.diag(arrays.noise_cov))
        noise_cov = jnp.asarray(arrays.noise_cov / np.outer(sigma, sigma))
        epochs = jnp.arange(len(arrays.times))
        gains, times = jnp.asarray(arrays.gains), jnp.asarray(arrays.reading_times)

        def one(
            measurements: Any,
            transition: Any,
            process_cov: Any,
            references: Any,
            rows: Any,
            offsets: Any,
        ) -> Any:
            def h(x: Any, k: Any) -> Any:
                east, north, up = rows[k] @ x
                latitude, longitude, height = references[k]
                meridian, prime_vertical = nm.radii(jnp, latitude)
                position = jnp.stack(
                    [
                        latitude - north / (meridian + height),
                        longitude - east / ((prime_vertical + height) * jnp.cos(latitude)),
                        height - up,
                    ]
                )
                return (offsets[k] + gains[k] * tensor_at(position, times[k])) / sigma

            first = transition[0]
            parameters = ParamsNLGSSM(
                initial_mean=first @ arrays.prior_mean,
                initial_covariance=first @ arrays.prior_cov @ first.T + process_cov[0],
                dynamics_function=lambda x, k: transition[k] @ x,
                dynamics_covariance=process_cov,
                emission_function=h,
                emission_covariance=noise_cov,
            )
            posterior = self.filter(parameters, measurements / sigma, epochs)
            return posterior.filtered_means, posterior.filtered_covariances

        self.call = jax.jit(jax.vmap(one) if self.together else one)
        self.inputs = [
            jnp.asarray(part)
            for part in (
                arrays.measurements,
                arrays.transition,
                arrays.process_cov,
                arrays.references,
                arrays.rows,
                arrays.offsets,
            )
        ]
        if self.together:
            self.runs_per_call = arrays.runs

    def filter(self, parameters: Any, measurements: Any, epochs: Any) -> Any:
        """Run dynamax's filter over one run."""
        fields = ["filtered_means", "filtered_covariances"]
        return extended_kalman_filter(parameters, measurements, inputs=epochs, output_fields=fields)

    def solve(self, run: int) -> np.ndarray:
        """Return the means (runs_per_call, K, n) of one run, or of all runs with ``together``."""
        if self.together:
            means, covs = self.call(*self.inputs)
        else:
            means, covs = self.call(*(part[run] for part in self.inputs))
            means = means[None]
        covs.block_until_ready()
        return np.asarray(means)


class Ukf(Ekf):
    """UKF by unscented_kalman_filter with the paper's sigma points, jitted, one run per call."""

    def filter(self, parameters: Any, measurements: Any, epochs: Any) -> Any:
        """Run dynamax's filter over one run."""
        fields = ["filtered_means", "filtered_covariances"]
        # λ = α² (n + κ) − n = 3 − n, without extra weight at the centre: the paper's sigma points.
        points = UKFHyperParams(alpha=1.0, beta=0.0, kappa=3.0 - len(self.arrays.prior_mean))
        return unscented_kalman_filter(
            parameters, measurements, points, inputs=epochs, output_fields=fields
        )


class EkfTogether(Ekf):
    """EKF, vmapped over all runs of the file."""

    together = True


class UkfTogether(Ukf):
    """UKF, vmapped over all runs of the file."""

    together = True
