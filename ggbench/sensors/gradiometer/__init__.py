"""Gravity gradiometer: measurement axes, signal chain, errors."""
