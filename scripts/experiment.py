"""Run an experiment of the paper on made sessions, and on its real frames if they are there; write its files.

    python scripts/experiment.py table1     # the shafts' axes: distances from one point, against PnP
    python scripts/experiment.py figure4    # loss of the best of N candidates, by the space they are drawn from
    python scripts/experiment.py table2     # simulated open-loop picking after one calibration

`make experiments` runs all three. The files are data/experiments/NAME.json, .md and .png.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from experiments import figure4, table1, table2
from experiments.parts import Options
from measuring.report import ROOT, SHARED

EXPERIMENTS: Final = {"table1": table1.run, "figure4": figure4.run, "table2": table2.run}


def main() -> None:
    """Run the experiment that was chosen."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=EXPERIMENTS, metavar="NAME", help="table1, figure4 or table2")
    out = ROOT / "data" / "experiments"
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help="default: data/experiments")
    parser.add_argument("--quick", action="store_true", help="a small run of less than a minute, to test the script")
    frames = "folder of real frames and meshes (default: shared, beside the checkout)"
    parser.add_argument("--shared", type=Path, default=SHARED, metavar="DIR", help=frames)
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all random numbers (default: %(default)s)")
    options = vars(parser.parse_args())
    EXPERIMENTS[options.pop("name")](Options(**options))


if __name__ == "__main__":
    main()
