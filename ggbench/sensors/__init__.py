"""Sensors other than the INS, and the measurement model with h and H."""
