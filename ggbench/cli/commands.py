"""Base class of all commands: exit codes and output streams."""

from __future__ import annotations

import io
import math
import sys
from typing import Any

import click

from ..errors import GGBenchError
from ..files.writing import end_if_asked, out_of_space, reason_of
from .interrupts import requests_to_end

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


def _finite(context: click.Context, option: click.Parameter, value: Any) -> Any:
    """Return the value of an option; raise GGBenchError if it is nan or infinite.

    Ranges of click accept nan. Only the option ``--void`` may be nan.
    """
    values = value if isinstance(value, tuple) else (value,)
    for each in values if option.name != "void" else ():
        if isinstance(each, float) and not math.isfinite(each):
            raise GGBenchError(f"{option.opts[0]} {each:g} must be a finite number")
    return value


class Commands(click.Group):
    """A group of commands in which a user error prints its message and exits with code 2."""

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """Add a command or a group of commands; their options refuse nan and infinite numbers.

        The option ``--void`` is an exception.
        """
        for command in (cmd, *getattr(cmd, "commands", {}).values()):
            for option in command.params:
                if isinstance(option.type, click.types.FloatParamType) and not option.callback:
                    option.callback = _finite
        super().add_command(cmd, name)

    def main(self, *arguments: Any, **options: Any) -> Any:
        """Run a command; print ``?`` for each character that the terminal cannot encode."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")
        return super().main(*arguments, **options)

    def invoke(self, context: click.Context) -> Any:
        """Run a command until it ends or a signal ends it."""
        with requests_to_end(EXIT_INTERRUPTED):
            return self._told(context)

    def _to_its_end(self, context: click.Context) -> Any:
        """Run a command; raise KeyboardInterrupt if the command has suppressed an interrupt."""
        try:
            result = super().invoke(context)
        except SystemExit as end:
            if not end.code:
                end_if_asked()
            raise
        end_if_asked()
        return result

    def _told(self, context: click.Context) -> Any:
        try:
            return self._to_its_end(context)
        except GGBenchError as error:
            click.echo(f"ggbench: {error}", err=True)
            context.exit(EXIT_BAD_INPUT)
        except OSError as error:
            if not out_of_space(error):
                raise
            click.echo(
                f"ggbench: cannot write {error.filename or 'the output'}: {reason_of(error)}",
                err=True,
            )
            context.exit(EXIT_BAD_INPUT)
        except KeyboardInterrupt:
            click.echo("Interrupted.", err=True)
            context.exit(EXIT_INTERRUPTED)
