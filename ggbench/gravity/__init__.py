"""The gravity field and its gradient: ellipsoid, harmonics, maps as splines, terrain masses."""
