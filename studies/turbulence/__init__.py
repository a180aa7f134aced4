"""Study: light aircraft in gusts, simulated by JSBSim for the scenario ``turbulence``."""

INTENSITIES = {"calm": 0, "light": 3, "moderate": 4, "severe": 6}
"""Severities of turbulence in JSBSim; 0: no turbulence.

The severities 3, 4 and 6 are exceeded with the probabilities 10⁻², 10⁻³ and 10⁻⁵."""
