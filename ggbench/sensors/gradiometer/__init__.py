"""The gravity gradiometer: what it reads, its signal chain, its errors."""
