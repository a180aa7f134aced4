"""The random numbers of a run: a generator for each source of error."""

from __future__ import annotations

import numpy as np


class RandomStreams:
    """The generators of a run, one per source of error, each made when it is first used."""

    SOURCES = (
        "initial",
        "biases",
        "imu",
        "gradiometer",
        "bias_walks",
        "imu_errors",
        "altimeter",
        "gradiometer_biases",
        "gradiometer_errors",
        "outliers",
        "dropouts",
        "timing",
        "behind_filter",
        *(
            f"{sensor}{source}"
            for sensor in ("gnss", "velocity_log", "barometer", "gravimeter")
            for source in ("", "_biases", "_outliers", "_dropouts")
        ),
    )
    """New sources come last: the number of a source is part of its seed."""

    def __init__(self, seed: int, run: int) -> None:
        self._entropy = [seed, run]

    def __getattr__(self, source: str) -> np.random.Generator:
        if source not in self.SOURCES:
            raise AttributeError(f"there is no source of errors {source!r}")
        # The child that SeedSequence.spawn would give in this place.
        child = np.random.SeedSequence(self._entropy, spawn_key=(self.SOURCES.index(source),))
        generator = np.random.default_rng(child)
        setattr(self, source, generator)
        return generator


def random_streams(seed: int, run: int) -> RandomStreams:
    """Return the generators of a run, spawned from the campaign's seed and the run's number."""
    return RandomStreams(seed, run)
