"""Protection of committed data with which tests compare."""

from __future__ import annotations

import os
import sys


def refuse_in_ci(script: str) -> None:
    """Exit with code 2 if CI is set: a test run must not rewrite the data that it compares with."""
    if os.environ.get("CI", "").lower() not in ("", "0", "false"):
        print(
            f"{script}: not run in CI: committed data must not change there (unset CI to make it anew)", file=sys.stderr
        )
        sys.exit(2)
