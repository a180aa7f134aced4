"""How tables and figures name estimators: an engine changes the time of a run, not its answer."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

_ENGINE = re.compile(r"(?<=[\[,])engine=[^,\]]*,?")


def shown_names(labels: Iterable[str]) -> dict[str, str]:
    """Return what each label is shown as: without its engine, ``ekf`` of ``ekf[engine=numba]``.

    Labels that would not differ then are shown whole.
    """
    short = {label: _without_engine(label) for label in labels}
    times = Counter(short.values())
    return {label: name if times[name] == 1 else label for label, name in short.items()}


def _without_engine(label: str) -> str:
    name, bracket, parameters = label.partition("[")
    if not bracket:
        return label
    kept = _ENGINE.sub("", f"[{parameters}").strip("[]").rstrip(",")
    return f"{name}[{kept}]" if kept else name
