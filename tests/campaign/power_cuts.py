"""Kill the command before its first write, a later one, ..., and complete it every time.

    python power_cuts.py STRIDE [OPTION ...]

It runs in the current folder, and prints the number of writes at which the command was killed at
last. A process of its own: each run is a fork of it, and the tests' processes are large.
"""

from __future__ import annotations

import os
import signal
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path

from campaigns import assert_equal, ran
from command import invoke
from problems import SMALL

from ggbench.cli.main import main
from ggbench.results.folder import Results


def in_child(action: Callable[[], None]) -> int:
    """Do something in a forked process; return how it ended, as subprocess does."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            action()
            code = 0
        except SystemExit as end:
            code = end.code or 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def killed_at_write(number: int, arguments: list[str]) -> int:
    """Run the command in a child that kills itself before its write ``number``; its exit code.

    Writes are: opening a file to write, renaming and removing one, making a folder, and every
    statement that reaches the database.
    """

    def run() -> None:
        left = number

        def tick(*_: object) -> None:
            nonlocal left
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)

        def connect(*arguments: object, **options: object) -> sqlite3.Connection:
            connection = plain_connect(*arguments, **options)
            connection.set_trace_callback(tick)
            return connection

        def watch(event: str, values: tuple) -> None:
            if event in ("os.rename", "os.remove", "os.mkdir") or (
                event == "open" and isinstance(values[2], int) and values[2] & os.O_ACCMODE
            ):
                tick()

        plain_connect, sqlite3.connect = sqlite3.connect, connect
        sys.addaudithook(watch)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno())
        main(arguments, prog_name="ggbench")

    return in_child(run)


def cut(here: Path, stride: int, options: list[str]) -> int:
    """Return the number of the first write that the command does not reach."""
    (here / "small.toml").write_text(SMALL)
    whole = ran(here, "whole", ("ins", "ekf"), runs=2)
    run = ["run", "small.toml", "-s", "5", "-n", "2", "-j", "0"]
    # What a child would import each time is loaded here, once.
    assert invoke([*run, "-o", str(here / "first")], here).returncode == 0
    number, code = len(options), -signal.SIGKILL
    while code != 0:
        folder = here / f"out{number}"
        if options:
            ran(here, folder.name, ("ins",), runs=1, seed=6).store.close()
        code = killed_at_write(number, [*run, "-o", str(folder), *options])
        assert code in (0, -signal.SIGKILL), f"ended with {code} at write {number}"
        if code:
            assert killed_at_write(10**9, [*run, "-o", str(folder)]) == 0
        assert_equal(Results(folder), whole)
        assert not list(folder.glob(".*.part"))
        number += stride
    return number


if __name__ == "__main__":
    print(cut(Path.cwd(), int(sys.argv[1]), sys.argv[2:]))
