"""How many random tries the tests of damaged inputs make, in one place.

The numbers suit `make test`; DVRK_CMAES_TEST_TRIES multiplies those of quick tries: .ci/run makes 3.4 times as many.
"""

from __future__ import annotations

import os

TIMES = float(os.environ.get("DVRK_CMAES_TEST_TRIES", "1"))

ANY = 12
"""Tries of a family of files by any of its commands, in every run; these take 50 to 300 ms of processor time each."""

INSPECTED = 60
"""Tries of a family whose file `inspect` reads, all but those by any command by that: some 5 ms each."""

SLOW = {"URDF": 18, "camera": 36, "golden.json": 30, "options": 60}
"""Tries of families that take longer, or that are quick without `inspect`; 10 to 20 ms each."""


def quick_tries(number: int) -> int:
    """Give a number of quick tries by the budget of this run; at least those by any command."""
    return max(ANY, round(TIMES * number))
