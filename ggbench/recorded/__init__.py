"""Recorded flights: read into problems, simulated runs written as such, corrected tracks."""
