"""h of a problem as a function of JAX, in SI units."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from problems import noisy_problem

pytest.importorskip("jax")

import jax

from ggbench.adapters.jax_callback import measurement_function

close = functools.partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)


def test_h_and_its_derivative_are_those_of_the_model():
    """Compiled, and in batches of states, of epochs and of both."""
    problem = noisy_problem(3)
    h = jax.jit(measurement_function(problem))
    rng = np.random.default_rng(1)
    x = problem.prior_mean + rng.normal(size=(4, problem.dimension)) * np.sqrt(
        np.diag(problem.prior_cov)
    )
    epochs = np.array([0, 3, 3, problem.epochs - 1])
    expected = [problem.model.predict(int(k), state) for k, state in zip(epochs, x, strict=True)]
    close(h(x[1], 3), expected[1])
    close(jax.vmap(h)(x, epochs), expected)
    close(jax.vmap(h, (0, None))(x, 3), problem.model.predict(3, x))
    close(jax.vmap(h, (None, 0))(x[0], epochs)[3], problem.model.predict(problem.epochs - 1, x[0]))
    rows = jax.vmap(jax.jacfwd(h))(x, epochs)
    for k, state, found in zip(epochs, x, rows, strict=True):
        close(found, problem.model.jacobian(int(k), state))
