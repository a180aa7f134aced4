"""True flights: manoeuvres, terrain following, tracks."""
