"""The random numbers of a run: a generator for each source of error."""

from __future__ import annotations

import hashlib
from typing import Literal

import numpy as np

_FIRST_SENSORS = ("gnss", "velocity_log", "barometer", "gravimeter")
"""Aiding sensors whose sources have places in the list, and keep them."""
Source = Literal["", "biases", "outliers", "dropouts", "lever_arm"]
"""Sources of errors of an aiding sensor; "" is its noise."""
_KEY_WORDS = 4
"""Length of the spawn key of a named sensor's source; longer than one, which a place has."""


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
            for sensor in _FIRST_SENSORS
            for source in ("", "_biases", "_outliers", "_dropouts")
        ),
        "gradiometer_scale",
        "gradiometer_tilt",
        "gradiometer_tails",
        "gnss_lever_arm",
        "gradiometer_mounting",
    )
    """New sources come last: the number of a source is part of its seed."""

    def __init__(self, seed: int, run: int) -> None:
        self._entropy = [seed, run]
        self._named: dict[tuple[str, str], np.random.Generator] = {}

    def __getattr__(self, source: str) -> np.random.Generator:
        if source not in self.SOURCES:
            raise AttributeError(f"there is no source of errors {source!r}")
        # The child that SeedSequence.spawn would give in this place.
        generator = self._generator(self.SOURCES.index(source))
        setattr(self, source, generator)
        return generator

    def _generator(self, *key: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self._entropy, spawn_key=key))

    def of_sensor(self, sensor: str, source: Source = "") -> np.random.Generator:
        """Return the generator of an aiding sensor, of its noise or another source.

        That of a named sensor follows from its name, whatever else is on board.
        """
        if sensor in _FIRST_SENSORS:
            found: np.random.Generator = getattr(self, f"{sensor}_{source}" if source else sensor)
            return found
        if (sensor, source) not in self._named:
            digest = hashlib.sha256(f"{sensor}/{source}".encode()).digest()
            key = np.frombuffer(digest, dtype="<u4", count=_KEY_WORDS)
            self._named[sensor, source] = self._generator(*key.tolist())
        return self._named[sensor, source]


def random_streams(seed: int, run: int) -> RandomStreams:
    """Return the generators of a run, spawned from the campaign's seed and the run's number."""
    return RandomStreams(seed, run)
