"""What an estimator remarks of a run: stored so that it can be read again, or refused."""

from __future__ import annotations

import pytest
from campaigns import failed

from ggbench.campaign.records import remarks
from ggbench.results.database import Result
from ggbench.results.store import Store


def nested(depth: int) -> dict:
    found: dict = {}
    for _ in range(depth):
        found = {"": found}
    return found


@pytest.mark.parametrize(
    "info",
    [
        {"file": "a\udc80b"},
        {"a\ud83db": [1, {"c": "\udfff"}]},
        {"nul": "a\0b", "escape": "\x1b[31m", "not a number": float("nan")},
        {"large": 10**4000, "infinite": float("inf")},
        *({"deep": nested(depth)} for depth in (150, 190, 195, 196, 197, 198, 199, 200, 205, 900)),
        {"larger": 10**5000},
        {"long": "x" * 200_000},
        nested(100_000),
    ],
    ids=lambda info: str(next(iter(info)))[:9].encode(errors="replace").decode(),
)
def test_remarks_that_are_accepted_can_be_read_again(info, tmp_path):
    """Whatever is in them: they are refused before anything is written, or come back the same."""
    try:
        kept = remarks(info)
    except (ValueError, RecursionError):
        return
    store = Store(tmp_path, create=True)
    store.add([Result("key", failed(info=kept))])
    (found,) = store.records("key", 1)
    assert found["reason"] == "none"
    assert str(found["info"]) == str(kept)


def test_halves_of_characters_cost_no_run():
    """A remark with the name of a file in other bytes is kept, with what can be said of it."""
    assert remarks({"file": "a\udc80b", "\ud83d": 1}) == {"file": "a?b", "?": 1}
    assert remarks({"smile": "😀", "nul": "\0"}) == {"smile": "😀", "nul": "\0"}
