"""Sensors other than the INS, and the measurement model h and H."""
