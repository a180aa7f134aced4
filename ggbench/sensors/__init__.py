"""What is on board other than the INS, and the measurement model h and H of its readings."""
