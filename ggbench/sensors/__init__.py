"""What is on board beside the INS, and the measurement model h and H of its readings."""
