"""Random numbers of a run: one generator for each named error source."""

from __future__ import annotations

import numpy as np

from ..spec.draws import words_of

FIRST_KEYS = {
    "initial_error": 0,
    "imu/biases": 1,
    "imu/": 2,
    "gradiometer/": 3,
    "imu/bias_walks": 4,
    "imu/errors": 5,
    "altimeter/": 6,
    "gradiometer/biases": 7,
    "gradiometer/errors": 8,
    "gradiometer/outliers": 9,
    "gradiometer/dropouts": 10,
    "gradiometer/timing": 11,
    "gradiometer/behind_filter": 12,
    "gnss/": 13,
    "gnss/biases": 14,
    "gnss/outliers": 15,
    "gnss/dropouts": 16,
    "velocity_log/": 17,
    "velocity_log/biases": 18,
    "velocity_log/outliers": 19,
    "velocity_log/dropouts": 20,
    "barometer/": 21,
    "barometer/biases": 22,
    "barometer/outliers": 23,
    "barometer/dropouts": 24,
    "gravimeter/": 25,
    "gravimeter/biases": 26,
    "gravimeter/outliers": 27,
    "gravimeter/dropouts": 28,
    "gradiometer/scale": 29,
    "gradiometer/tilt": 30,
    "gradiometer/tails": 31,
    "gnss/lever_arm": 32,
    "gradiometer/mounting": 33,
}
"""Keys of the first sources; keys of all other sources follow from the names.

Stored results depend on these keys. The table is complete: a new source needs no row.
"""


def spawn_key(source: str) -> tuple[int, ...]:
    """Return the spawn key of an error source, which depends only on the name.

    Parameters
    ----------
    source : str
        Name ``SENSOR/ERROR``; ``SENSOR/`` is the white noise of a sensor.
    """
    return (FIRST_KEYS[source],) if source in FIRST_KEYS else words_of(source)


class RandomStreams:
    """Random generators of a run by error source, each created at first use.

    The generators are spawned from the campaign seed and the run index
    (:class:`numpy.random.SeedSequence`). The random numbers of a source depend on no other source.

    Parameters
    ----------
    seed : int
        Seed of the campaign.
    run : int
        Index of the run.
    draw : str
        Key ``draw.name`` of the case, which enters the seed unless it is empty.
    """

    def __init__(self, seed: int, run: int, draw: str = "") -> None:
        self._entropy = [seed, run, *words_of(draw)]
        self._generators: dict[str, np.random.Generator] = {}

    def __getitem__(self, source: str) -> np.random.Generator:
        """Return the generator of a source, named as in :func:`spawn_key`."""
        if source not in self._generators:
            child = np.random.SeedSequence(self._entropy, spawn_key=spawn_key(source))
            self._generators[source] = np.random.default_rng(child)
        return self._generators[source]
