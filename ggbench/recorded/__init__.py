"""Recorded flights: reader of records, writer for simulated runs, corrected tracks."""
