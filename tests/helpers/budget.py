"""How many random tries the tests of damaged inputs make, in one place.

The numbers suit every run of the tests; with ``DVRK_CMAES_TEST_TRIES=10`` there are ten times as many.
"""

from __future__ import annotations

import os

TIMES = float(os.environ.get("DVRK_CMAES_TEST_TRIES", "1"))

ANY = 12
"""Tries of a family of files by any of its commands."""

INSPECTED = 60
"""Tries of a family whose file `inspect` reads, most of them by that: they take some 5 ms of processor time each."""

SLOW = {"URDF": 30, "camera": 50, "golden.json": 40, "options": 60}
"""Tries of families that take longer, or that are quick without `inspect`; 10 to 20 ms each."""


def tries(number: int) -> int:
    """Give a number of tries by the budget of this run; at least one."""
    return max(1, round(TIMES * number))
