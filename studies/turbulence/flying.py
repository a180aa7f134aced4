"""Flights of a light aircraft with a pilot in the gusts of MIL-F-8785C, by JSBSim.

The aircraft is JSBSim's Cessna 172 (``c172x``): a rigid body with six degrees of freedom and
tabulated aerodynamics. The gusts are JSBSim's Dryden turbulence above 2000 ft. Their intensity
depends on the height and on the probability of exceedance (MIL-F-8785C, figure 7). The pilot
commands attitudes to hold heading and height, and does not correct every gust.
"""

from __future__ import annotations

import math
from pathlib import Path

import jsbsim
import numpy as np

from . import INTENSITIES

FOOT = 0.3048
"""Length of a foot [m]."""
COLUMNS = {
    "time_s": 1,
    "latitude_deg": 12,
    "longitude_deg": 12,
    "height_m": 7,
    "heading_deg": 5,
    "pitch_deg": 5,
    "roll_deg": 5,
}
"""Columns of a track, with their numbers of decimals.

Positions are rounded to 0.1 µm. At 10 Hz this rounding adds accelerations of only 10 µm/s²."""
SEED = 8785
STEPS_A_ROW = 12
"""Number of JSBSim steps of 1/120 s between two rows, which are 0.1 s apart."""

_HEIGHT, _HEADING, _SPEED = 1280.0, 70.0, 55.0
_START = {
    "ic/lat-geod-deg": 36.255,
    "ic/long-gc-deg": -84.374,
    "ic/terrain-elevation-ft": 450.0 / FOOT,
    "ic/h-sl-ft": _HEIGHT / FOOT,
    "ic/vt-kts": _SPEED * 3600.0 / 1852.0,
    "ic/psi-true-deg": _HEADING,
}
_BEFORE = 100.0
"""Time before the start of the track, in which flight and gusts become steady [s]."""


def track(intensity: str, duration: float = 300.0, seed: int = SEED) -> np.ndarray:
    """Simulate a flight in turbulence and return its track (N, 7), one row per 0.1 s.

    :data:`COLUMNS` names the columns. Latitude and longitude are geodetic; the height is above the
    ellipsoid. The heading is clockwise from north, and roll to the right is positive.

    Parameters
    ----------
    intensity : key of :data:`.INTENSITIES`.
    duration : duration of the track [s].
    seed : seed of JSBSim's random numbers.
    """
    jsbsim.FGJSBBase().debug_lvl = 0  # no banner
    aircraft = jsbsim.FGFDMExec(str(Path(jsbsim.__file__).parent))
    aircraft.load_model("c172x")
    aircraft.disable_output()
    aircraft["simulation/randomseed"] = seed
    for key, value in _START.items():
        aircraft[key] = value
    aircraft.run_ic()
    aircraft["propulsion/set-running"] = -1
    aircraft["fcs/mixture-cmd-norm"] = 0.87
    aircraft["fcs/throttle-cmd-norm"] = 0.7
    aircraft.do_trim(1)
    pilot = _Pilot(aircraft)
    if INTENSITIES[intensity]:
        aircraft["atmosphere/turb-type"] = 3  # MIL-F-8785C, Dryden
        aircraft["atmosphere/turbulence/milspec/severity"] = INTENSITIES[intensity]
    before, rows = round(_BEFORE / aircraft.get_delta_t()), round(10.0 * duration) + 1
    found = np.empty((rows, len(COLUMNS)))
    for step in range(before + STEPS_A_ROW * (rows - 1) + 1):
        if step >= before and (step - before) % STEPS_A_ROW == 0:
            row = (step - before) // STEPS_A_ROW
            found[row] = (
                0.1 * row,
                aircraft["position/lat-geod-deg"],
                aircraft["position/long-gc-deg"],
                aircraft["position/geod-alt-ft"] * FOOT,
                aircraft["attitude/psi-deg"],
                aircraft["attitude/theta-deg"],
                aircraft["attitude/phi-deg"],
            )
        pilot.fly()
        aircraft.run()
    return found


class _Pilot:
    """Pilot that holds heading and height by attitude commands, and speed by the throttle."""

    def __init__(self, aircraft: jsbsim.FGFDMExec) -> None:
        self.aircraft = aircraft
        self.elevator = aircraft["fcs/elevator-cmd-norm"]
        self.throttle = aircraft["fcs/throttle-cmd-norm"]
        self.pitch = aircraft["attitude/theta-deg"]
        self.missing_height = self.missing_heading = 0.0

    def fly(self) -> None:
        """Set elevator, aileron and throttle for the next step."""
        a, step = self.aircraft, self.aircraft.get_delta_t()
        roll_rate, pitch_rate = (
            math.degrees(a[f"velocities/{axis}-rad_sec"]) for axis in ("p", "q")
        )
        too_low = _HEIGHT - a["position/geod-alt-ft"] * FOOT
        too_left = (_HEADING - a["attitude/psi-deg"] + 180.0) % 360.0 - 180.0
        self.missing_height = _within(self.missing_height + 0.002 * too_low * step, 3.0)
        self.missing_heading = _within(self.missing_heading + 0.02 * too_left * step, 5.0)
        climb = a["velocities/h-dot-fps"] * FOOT
        pitch = self.pitch + self.missing_height + _within(0.05 * too_low - 0.3 * climb, 5.0)
        roll = _within(1.0 * too_left + self.missing_heading, 15.0)
        elevator = self.elevator + 0.03 * (a["attitude/theta-deg"] - pitch) + 0.01 * pitch_rate
        aileron = 0.02 * (roll - a["attitude/phi-deg"]) - 0.005 * roll_rate
        slow = _SPEED - a["velocities/vtrue-kts"] * 1852.0 / 3600.0
        a["fcs/elevator-cmd-norm"] = _within(elevator, 1.0)
        a["fcs/aileron-cmd-norm"] = _within(aileron, 1.0)
        a["fcs/throttle-cmd-norm"] = min(max(self.throttle + 0.05 * slow, 0.05), 1.0)


def _within(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
