"""Random streams of a run: each source of error has its own, which its name determines."""

from __future__ import annotations

import numpy as np

from ggbench.simulation.random_streams import FIRST_KEYS, RandomStreams, spawn_key
from ggbench.spec.aiding import KINDS

SENSORS = ("stern", "bow", "gnss_biases", "imu", "gradiometer", "altimeter", *KINDS)
SOURCES = ("", "biases", "outliers", "dropouts", "lever_arm", "errors", "tilt")
NAMES = {"initial_error", *FIRST_KEYS, *(f"{s}/{source}" for s in SENSORS for source in SOURCES)}
STERN_DRAWN, STERN_BIAS_DRAWN = 0.6790752617505998, 0.8023681955586441
"""First draws of a named sensor for seed 1 and run 0."""


def test_no_two_sources_share_a_key():
    """Nor can any name get the key of a source in the table: it is longer."""
    assert len({spawn_key(name) for name in NAMES}) == len(NAMES)
    assert {len(spawn_key(name)) for name in FIRST_KEYS} == {1}
    assert {len(spawn_key(name)) for name in NAMES - FIRST_KEYS.keys()} == {4}


def test_each_seed_run_and_source_has_a_stream_of_its_own():
    drawn = {
        (seed, run, name): RandomStreams(seed, run)[name].random()
        for seed in (1, 2)
        for run in (0, 1)
        for name in NAMES
    }
    assert len(set(drawn.values())) == len(drawn)


def test_a_stream_continues_whatever_else_is_used():
    """The same numbers alone and between others; a second look does not start it again."""
    alone, among = RandomStreams(3, 5)["stern/biases"], RandomStreams(3, 5)
    for name in NAMES:
        among[name].random(3)
    alone.random(3)
    np.testing.assert_array_equal(among["stern/biases"].random(4), alone.random(4))


def test_streams_are_those_of_stored_results():
    """Results could not be made again otherwise, here, in other processes and in later versions.

    The first sources have the children that NumPy spawns, in the order of the table.
    """
    children = np.random.SeedSequence([5, 7]).spawn(len(FIRST_KEYS))
    streams = RandomStreams(5, 7)
    assert list(FIRST_KEYS.values()) == list(range(34))
    for name, child in reversed(list(zip(FIRST_KEYS, children, strict=True))):
        np.testing.assert_array_equal(
            streams[name].random(5), np.random.default_rng(child).random(5)
        )
    order = ["initial_error", "imu/biases", "imu/", "gradiometer/", "imu/bias_walks"]
    assert list(FIRST_KEYS)[:5] == order
    assert RandomStreams(1, 0)["stern/"].random() == STERN_DRAWN
    assert RandomStreams(1, 0)["stern/biases"].random() == STERN_BIAS_DRAWN
