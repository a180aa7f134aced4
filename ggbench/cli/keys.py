"""``ggbench keys``: what the tables and keys of a scenario file mean."""

from __future__ import annotations

import difflib
import re
import textwrap
from typing import TYPE_CHECKING

import click

from ..errors import GGBenchError
from .screen import console

if TYPE_CHECKING:
    from .key_tables import Key, KeyTable

_MOST_NEAR = 3


class KeyNameError(GGBenchError):
    """There is no table and no key of a name."""


@click.command()
@click.argument("name", metavar="[TABLE[.KEY]]", required=False)
def keys(name: str | None) -> None:
    """Explain the keys of a scenario file.

    Without an argument: its tables. With a table, as "imu" or "truth.gradiometer": its keys with
    unit, type, default and limits. With a key, as "imu.period_s" or "period_s": that key, in every
    table that has it.
    """
    from . import key_tables

    if name is None:
        for each in key_tables.tables().values():
            _say(each.heading, each.about)
        _say("", "'ggbench keys TABLE' lists the keys of a table, as in: ggbench keys imu")
        return
    table = key_tables.tables().get(key_tables.named(name))
    found = key_tables.find(name)
    if table is None and not found:
        raise _unknown(name)
    if table is not None:
        _tell_table(table)
    else:
        for place, key in found:
            _tell_key(key, f"{place.name}.", key in place.recorded)


def _unknown(name: str) -> KeyNameError:
    from .key_tables import every_name, named

    near = difflib.get_close_matches(named(name), every_name(), n=_MOST_NEAR, cutoff=0.7)
    meant = f"; did you mean {' or '.join(map(repr, near))}?" if near else "."
    return KeyNameError(
        f"a scenario file has no table and no key '{name}'{meant} 'ggbench keys' lists the tables"
    )


def _tell_table(table: KeyTable) -> None:
    from .key_tables import tables

    _say(table.heading, table.about)
    for key in table.keys:
        _tell_key(key)
    for key in table.recorded:
        _tell_key(key, recorded=True)
    within = [t.heading for t in tables().values() if t.name.startswith(f"{table.name}.")]
    if within:
        _say("", f"Tables within it: {', '.join(within)}.")


def _tell_key(key: Key, prefix: str = "", recorded: bool = False) -> None:
    from .key_tables import REQUIRED

    facts = [", ".join(filter(None, (key.unit, key.kind)))]
    facts.append(key.default if key.default == REQUIRED else f"default: {key.default}")
    if key.allowed:
        facts.append(f"allowed: {key.allowed}" + (f", usual: {key.usual}" if key.usual else ""))
    if recorded:
        facts.append("in the file of a recorded flight alone")
    _say(prefix + key.name, "; ".join(facts))
    _say("", f"{key.meaning[:1].upper()}{key.meaning[1:]}.")


def _say(head: str, text: str) -> None:
    """Print a heading, and below it a text in lines that fit the terminal."""
    if head:
        click.secho(head, bold=True)
    width = max(console.width, 40)
    plain = re.sub(r"\*([\w ]+)\*|`", r"\1", text)
    for line in textwrap.wrap(plain, width - 4, break_long_words=False):
        click.echo(f"    {line}")
