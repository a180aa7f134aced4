"""The tracks of the scenario ``turbulence``: a light aircraft flown through gusts by JSBSim."""
