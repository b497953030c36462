"""The command line, ``dvrk-cmaes``. Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 doubtful.

Libraries that take long to load are imported by the functions that need them, so that ``--help`` is quick.
"""

from __future__ import annotations

from dvrk_cmaes.cli.app import main

__all__ = ["main"]
