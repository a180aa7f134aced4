"""The rivals of the speed benchmark solve the same problem: their h and H are ggbench's."""

import numpy as np
import pytest
from speed import export, numpy_model

RUNS = (0, 7)


@pytest.fixture(scope="module")
def both():
    arrays = export.arrays(RUNS)
    models = [problem.model for problem in export.problems(RUNS)]
    return arrays, [numpy_model.NumpyModel(arrays, r) for r in range(len(RUNS))], models


def states(arrays, spread, count=4, seed=5):
    rng = np.random.default_rng(seed)
    return arrays.prior_mean + spread * arrays.scale * rng.standard_normal((count, 15))


@pytest.mark.parametrize("spread", [0.0, 1.0, 100.0])
def test_the_readings_that_numpy_predicts_are_ggbenchs(both, spread):
    arrays, ours, theirs = both
    for run in range(len(RUNS)):
        for k in (0, 3, 77, 199):
            x = states(arrays, spread, seed=k)
            expected = theirs[run].predict(k, x)
            # The tensor is 3000 E: the rounding of a double is 5e-13 E.
            np.testing.assert_allclose(ours[run].predict_all(k, x), expected, rtol=0, atol=1e-9)
            for one, state in zip(expected, x, strict=True):
                np.testing.assert_allclose(ours[run].predict(k, state), one, rtol=0, atol=1e-9)


@pytest.mark.parametrize("spread", [0.0, 1.0, 100.0])
def test_the_jacobian_in_numpy_is_ggbenchs(both, spread):
    arrays, ours, theirs = both
    for run in range(len(RUNS)):
        for k in (0, 3, 77, 199):
            (x,) = states(arrays, spread, count=1, seed=k)
            expected = theirs[run].jacobian(k, x)
            # In units of the noise for one deviation of the prior.
            unit = arrays.scale / np.sqrt(np.diag(arrays.noise_cov))[:, None]
            scaled = (ours[run].jacobian(k, x) - expected) * unit
            assert np.abs(expected * unit).max() > 0.1
            np.testing.assert_allclose(scaled, 0.0, atol=1e-9)
