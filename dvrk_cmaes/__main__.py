"""Entry point of ``python -m dvrk_cmaes``, equivalent to the command ``dvrk-cmaes``."""

from __future__ import annotations

import sys

from dvrk_cmaes.cli import main

if __name__ == "__main__":
    sys.exit(main())
