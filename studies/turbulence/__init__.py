"""The tracks of the scenario ``turbulence``: a light aircraft flown through gusts by JSBSim."""

INTENSITIES = {"calm": 0, "light": 3, "moderate": 4, "severe": 6}
"""JSBSim's number of an intensity, which is exceeded with a probability of 10⁻², 10⁻³ or 10⁻⁵."""
