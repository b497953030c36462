"""Run every command once on small data: `python scripts/smoke.py [--extras]`, as with the lowest and newest libraries.

It copies the bundled session to a temporary folder, with settings with which a frame takes a fraction of a second. A
command that ends with another exit code than 0 and 3, or with an internal error, is a failure. With ``--extras``, those
that need optional libraries are run too. Of `live`, which needs a robot, only the help is read.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from fuzzing.families import QUICK

from dvrk_cmaes.frames.images import read_image
from dvrk_cmaes.io.files import bundled_path

_CAMERA: Final = "--camera session/camera.yaml"
_CONFIG: Final = "--config quick.toml"
COMMANDS: Final = (
    "--version",
    "help",
    "demo --out demo",
    "inspect session",
    "inspect session/camera.yaml",
    f"estimate --mask session/masks/0000.png {_CAMERA} --joints session/joints.csv {_CONFIG} --out one",
    f"estimate --image session/images/0001.jpg {_CAMERA} --joints none {_CONFIG} --out one",
    f"batch session --out results --workers 2 {_CONFIG}",
    f"calibrate session --out calibration --workers 2 {_CONFIG}",
    f"batch session --out again --workers 1 --session calibration --doubtful-session {_CONFIG}",
    f"track session --out tracks {_CONFIG}",
    f"track session --out images --evidence images --causal --no-page {_CONFIG}",
    "segment session --out found",
    f"golden record session --golden golden.json --overwrite --allow-doubtful {_CONFIG}",
    f"golden check session --golden golden.json {_CONFIG}",
    "synth made --frames 2 --level easy",
    "synth followed --frames 8 --motion video --no-images",
    "pnp made --out pnp",
    "compare results again --out differences",
    "consistency results again",
    "export calibration --to csv",
    "export calibration --to dvrk --out dvrk",
    "export results --to bop --out bop",
    "export calibration --to tum --out tum",
    f"import made_video.mp4 {_CAMERA} --joints times.csv --out imported",
    "live --help",
)
EXTRAS: Final = (
    "consistency results again --picture axes.png",
    "compare results again --picture differences.png",
    "export results --to ros1-bag --out ros1",
    "export results --to ros2-bag --out ros2",
    f"track session --out seen --rerun seen.rrd --no-page {_CONFIG}",
)
"""Command lines that are run in the folder of the session; see `dvrk-cmaes --help`."""


def main() -> int:
    """Run the commands and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--extras", action="store_true")
    options = parser.parse_args()
    failed = 0
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        shutil.copytree(bundled_path("demo"), place / "session")
        (place / "quick.toml").write_text(QUICK, encoding="utf-8")
        _write_video(place)
        for line in (*COMMANDS, *(EXTRAS if options.extras else ())):
            ran = subprocess.run(
                [sys.executable, "-m", "dvrk_cmaes", *line.split()],
                cwd=place,
                capture_output=True,
                text=True,
                check=False,
            )
            bad = ran.returncode not in (0, 3) or "Traceback" in ran.stderr or "internal error" in ran.stderr
            print(f"{'FAILED' if bad else 'ok':<7}{ran.returncode:<4}dvrk-cmaes {line}", flush=True)
            if bad:
                failed += 1
                print(f"{ran.stderr.strip()[-2000:]}\n", flush=True)
    print(f"{failed} of {len(COMMANDS) + len(EXTRAS) * options.extras} commands failed")
    return 1 if failed else 0


def _write_video(place: Path) -> None:
    """Write a video of the session's images, and readings with times."""
    import cv2

    video = cv2.VideoWriter(str(place / "made_video.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 25, (640, 480))
    for path in sorted((place / "session" / "images").iterdir()):
        video.write(read_image(path))
    video.release()
    (place / "times.csv").write_text("time,jaw\n0,0.1\n0.04,0.2\n0.08,0.3\n0.5,0.3\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
