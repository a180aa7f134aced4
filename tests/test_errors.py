"""What errors of libraries say fits into a sentence."""

from __future__ import annotations

import pytest

from ggbench.errors import text_of


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (ValueError("bad value"), "bad value"),
        (ValueError("bad value\n  at  line 3"), "bad value at line 3"),
        (ValueError("a\x00b\x1b[0m"), r"a\x00b\x1b[0m"),
        (KeyError(), "KeyError"),
        (ValueError("x" * 70000), "x" * 200),
    ],
)
def test_the_text_of_an_error_is_one_short_printable_line(error, text):
    assert text_of(error) == text
