"""Estimation frameworks side by side on one flight: answers, time, memory, size and behaviour."""
