"""The command line program ``dvrk-cmaes``. Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 doubtful.

Modules that take long to import are imported inside the functions that use them, to keep ``--help`` fast.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line (``sys.argv`` by default) and return its exit code; no error is raised."""
    from dvrk_cmaes.cli.overview import print_overview

    with contextlib.suppress(AttributeError, OSError):  # of a closed or full stdout: the app says what is wrong with it
        if print_overview(sys.argv[1:] if arguments is None else arguments):
            return 0
    from dvrk_cmaes.cli.app import main as run

    return run(arguments)
