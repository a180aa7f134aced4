"""Inertial navigation: mechanization, inertial sensors, the linear error model with Φ and Q."""
