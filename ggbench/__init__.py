"""A benchmark for gravity-gradient-aided inertial navigation.

Vocabulary, frames, units and shapes of all modules:

=====================  ============================================================================
navigation frame n     East-North-Up (ENU), local level on the WGS84 ellipsoid
body frame b           right-forward-up; heading clockwise from north (90° = flying east)
inertial frame i       Earth-centred; the axes coincide with the ECEF axes at t = 0
``c_nb``               rotation that maps b to n; a rotation is named ``c_to_from``
position               geodetic latitude and longitude [rad], height above the ellipsoid [m], (3,)
velocity               ENU relative to the Earth [m/s], (3,)
gradient tensor        [EE, EN, EU, NN, NU, UU] in E (1 E = 1e-9 s⁻²), (6,); gravitational part
error                  indicated (or estimated) minus true; sensor: measured = true + bias
attitude error φ       C̃_nb = (I − [φ×]) C_nb
error state            δr ENU [m], δv ENU [m/s], φ [rad], gyro bias [rad/s], accelerometer bias
                       [m/s²]: (15,); further states, each only if unknown: gravity disturbance,
                       mounting angles, sensor biases, lever arms
mount                  support of the gradiometer: a platform, a local level, or the body itself
channel                a measured number: a component of the tensor in the axes of the mount or a
                       linear combination of the six (gradiometer), or a component of the output
                       of another sensor (receiver, log, barometer, gravimeter)
truth, model           the truth is the simulated world; the model is the world that estimators
                       assume; a scenario may define a model that differs from the truth
map                    the disturbing field, gradient [E] and gravity [m/s²], on a grid of nodes
                       regular in latitude, longitude and height; the normal field is no part of it
converged              from an epoch on, the position error stays within the required limit until
                       the end of the flight
false fix              the final position error exceeds the required limit, although the reported
                       covariance indicates an error within the limit
root PSD               square root of a white noise's power spectral density
=====================  ============================================================================

Numbers are in SI units and radians. The end of a name states any other unit (``noise_eotvos``). The
first axis of arrays over time counts the epochs: (K, ...).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .numerics import cache
from .numerics.source import VERSION

if TYPE_CHECKING:
    from . import maps as maps
    from .api.exchange import export as export
    from .api.exchange import judge_estimates as judge_estimates
    from .api.planning import advise as advise
    from .api.planning import bound as bound
    from .api.planning import check as check
    from .api.planning import plan as plan
    from .api.planning import scorecard as scorecard
    from .api.problems import Judgement as Judgement
    from .api.problems import corrected as corrected
    from .api.problems import estimate as estimate
    from .api.problems import estimator as estimator
    from .api.problems import judge as judge
    from .api.problems import load as load
    from .api.problems import read_flight as read_flight
    from .api.problems import simulate as simulate
    from .api.results import Results as Results
    from .api.running import run as run
    from .api.running import sweep as sweep
    from .errors import GGBenchError as GGBenchError
    from .problem import Estimate as Estimate
    from .problem import Estimator as Estimator
    from .problem import Problem as Problem
    from .simulation.runs import Truth as Truth
    from .spec.scenario import Scenario as Scenario

__version__ = VERSION
cache.use_versioned_numba_cache()

_NAMES = {
    "api.exchange": ("export", "judge_estimates"),
    "api.planning": ("advise", "bound", "check", "plan", "scorecard"),
    "api.problems": (
        "Judgement",
        "corrected",
        "estimate",
        "estimator",
        "judge",
        "load",
        "read_flight",
        "simulate",
    ),
    "api.results": ("Results",),
    "api.running": ("run", "sweep"),
    "errors": ("GGBenchError",),
    "problem": ("Estimate", "Estimator", "Problem"),
    "simulation.runs": ("Truth",),
    "spec.scenario": ("Scenario",),
}
"""Public names by module. A module is imported at the first use of one of its names."""
_MODULES = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "maps":
        return import_module(".maps", __name__)
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*_MODULES, "maps", "__version__"])
