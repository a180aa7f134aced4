"""Refusals: errors of one line with a message."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def refused(
    errors: type[Exception] | tuple[type[Exception], ...], message: str
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """Require one of these errors, with a text of one line that matches a regular expression."""
    with pytest.raises(errors, match=message) as caught:
        yield caught
    assert "\n" not in str(caught.value)
