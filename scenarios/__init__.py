"""The scenarios of the benchmark: one TOML file each, with their data."""
