"""Inertial navigation: mechanization, inertial sensors, linear error model with Φ and Q."""
