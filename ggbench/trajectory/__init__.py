"""True trajectories: manoeuvres, terrain following, tracks from files."""
