"""A benchmark for gravity-gradient-aided inertial navigation.

Vocabulary, frames, units and shapes, used by every module:

=====================  ============================================================================
navigation frame n     East-North-Up (ENU), local level on the WGS84 ellipsoid
body frame b           right-forward-up; heading clockwise from north (90° = flying east)
inertial frame i       Earth-centred, its axes those of ECEF at t = 0
``c_nb``               rotation that maps b to n; a rotation is named ``c_to_from``
position               geodetic latitude and longitude [rad], height above the ellipsoid [m], (3,)
velocity               ENU relative to the Earth [m/s], (3,)
gradient tensor        [EE, EN, EU, NN, NU, UU] in E (1 E = 1e-9 s⁻²), (6,); gravitational part
error                  indicated (or estimated) minus true; sensor: measured = true + bias
attitude error φ       C̃_nb = (I − [φ×]) C_nb
error state            δr ENU [m], δv ENU [m/s], φ [rad], gyro bias [rad/s], accelerometer bias
                       [m/s²]: (15,); then a bias of each gradiometer channel [E], if the model
                       has any
mount                  what holds the gradiometer: a platform, a local level, or the body itself
channel                what a gradiometer delivers: a component of the tensor in the axes of its
                       mount, or a linear combination of the six
truth, model           what is simulated; what the estimators are told: a scenario may tell them
                       something else
map                    the disturbing field, gradient [E] and gravity [m/s²], on a grid of nodes
                       regular in latitude, longitude and height; the normal field is no part of it
lock                   staying below a given position error to the end of the flight; a false lock
                       claims to be there and is not
root PSD               square root of a white noise's power spectral density
=====================  ============================================================================

Numbers are SI and radians; a name that carries another unit says so (``noise_eotvos``). Arrays over
time have the epochs first: (K, ...).
"""

from importlib.metadata import version

from .numerics import cache

__version__ = version("ggbench")
cache.keep_apart()
