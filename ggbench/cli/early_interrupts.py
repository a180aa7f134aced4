"""Handler of interrupts during the import of the commands.

The import of the commands takes a few tenths of a second. Therefore this module is imported first.
Its handler ends the process with a short message. Programs that import the command, such as tests,
keep their own handlers.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path


def _end(number: int, frame: object) -> None:
    """End the process before the command starts; there are no results to summarise."""
    os.write(2, b"Interrupted.\n")
    os._exit(130)


if Path(sys.argv[0]).name in ("ggbench", "ggbench.exe") and (
    signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, _end)
