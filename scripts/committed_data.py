"""Data that is committed and that tests compare with."""

from __future__ import annotations

import os
import sys


def refuse_in_ci(script: str) -> None:
    """Leave with exit code 2 where CI is set: what tests compare with must not be made by the run that compares."""
    if os.environ.get("CI", "").lower() not in ("", "0", "false"):
        print(
            f"{script}: not run in CI: committed data must not change there (unset CI to make it anew)", file=sys.stderr
        )
        sys.exit(2)
