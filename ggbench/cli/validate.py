"""``ggbench validate``: errors, warnings and flights of a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from ..display.compiling import tell_first_use
from ..display.progress import Progress
from ..errors import line_of
from ..figures.numbers import counted
from .screen import console

if TYPE_CHECKING:
    from ..spec.scenario import Scenario


@click.command()
@click.argument("file")
@click.option(
    "--estimators",
    "with_estimators",
    is_flag=True,
    help="Also load the estimator files named in FILE; their code is run.",
)
def validate(file: str, with_estimators: bool) -> None:
    """Check the scenario FILE and describe its flights.

    FILE is a path or the name of a shipped scenario. The command warns of implausible flights and
    of flights near the border of the map. It runs no code of estimator files.
    It builds a map only if the map is draped over the ground, or the scenario adds errors to it.
    It simulates a run only if a flight exceeds a limit or may leave the map.
    """
    tell_first_use("ins/strapdown.py", "in a minute")
    with Progress(console, file):
        from ..campaign import registry
        from ..spec import scenario
        from . import flight_limits, flight_summary

        loaded = scenario.load(file)
        note_unusual_values(loaded)
        examinations = list(flight_limits.examined(loaded))
        named = [*loaded.campaign.estimators, loaded.campaign.assumption_estimator]
        listed = registry.listed(named)
        own = [] if with_estimators else [text for text in listed if registry.is_own(text)]
        registry.choose_all(text for text in listed if text not in own)
    click.echo(
        f"{file} is valid: {counted(len(loaded.cases), 'case')}, "
        f"{counted(len(loaded.assumptions), 'assumption')}, "
        f"{counted(len(loaded.provenance), 'value')} with provenance"
    )
    if own:
        click.echo(
            f"Not loaded: {', '.join(map(line_of, own))}; --estimators loads them and runs their "
            "code"
        )
    flight_summary.print_flights(examinations)
    flight_summary.warn(examinations)


def note_unusual_values(scenario: Scenario) -> None:
    """Print a remark on each unusual value of a scenario."""
    from ..spec.unusual_values import unusual_values

    for remark in unusual_values(scenario):
        click.echo(f"Note: {remark}.")
