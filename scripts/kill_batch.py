"""Kill a batch by SIGKILL at random times, resume it each time, and compare its files with an uninterrupted batch.

    python scripts/kill_batch.py --kills 20 --frames 60

Every second time a worker process is killed before the batch. After each kill the existing results must be complete. At
the end all files must be equal to those of an uninterrupted batch, except for times; the exit code is 1 if not.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from many_frames import repeated_session

from dvrk_cmaes.io.bundled import bundled_path


def main() -> int:
    """Run the batches and print the report as JSON; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--session",
        type=Path,
        default=bundled_path("demo"),
        help="session whose frames are repeated (default: the demo)",
    )
    parser.add_argument("--frames", type=int, default=60, metavar="N", help="number of frames (default: %(default)s)")
    parser.add_argument("--kills", type=int, default=20, metavar="N", help="number of kills (default: %(default)s)")
    parser.add_argument(
        "--longest", type=float, default=8.0, metavar="S", help="longest time until a kill, s (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the random times (default: %(default)s)"
    )
    parser.add_argument("options", nargs="*", help="options of dvrk-cmaes batch, after --")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as place:
        session = repeated_session(arguments.session, Path(place, "session"), arguments.frames)
        command = [sys.executable, "-m", "dvrk_cmaes", "batch", str(session), *arguments.options, "--out"]
        uninterrupted, killed = Path(place, "uninterrupted"), Path(place, "killed")
        _run_to_end([*command, str(uninterrupted)])
        kills, counts = 0, []
        while kills < arguments.kills:
            kills += _run_and_kill([*command, str(killed)], rng.uniform(0, arguments.longest), worker=kills % 2 == 1)
            counts.append(_count_complete(killed))
            print(f"{kills} kills: {counts[-1]} results, all whole", file=sys.stderr)
        _run_to_end([*command, str(killed)])
        differ = _differences(uninterrupted, killed)
    print(json.dumps({"kills": kills, "results after each": counts, "files that differ": differ}, indent=1))
    return 1 if differ else 0


def _run_to_end(command: Sequence[str]) -> None:
    """Run a batch; exit with a message unless its exit code is 0 or 3."""
    code = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False).returncode
    if code not in (0, 3):
        raise SystemExit(f"kill_batch.py: {' '.join(command)} ended with exit code {code}")


def _run_and_kill(command: Sequence[str], seconds: float, *, worker: bool) -> bool:
    """Run a batch and kill it after some seconds, optionally a worker first; False if it had ended by then."""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as batch:
        time.sleep(seconds)
        if batch.poll() is not None:
            return False
        if worker and (workers := _workers(batch.pid)):
            subprocess.run(["kill", "-KILL", str(workers[0])], check=False, stderr=subprocess.DEVNULL)
            time.sleep(0.5)
        batch.kill()
    return True


def _workers(pid: int) -> list[int]:
    """Return the ids of a batch's worker processes."""
    found = subprocess.run(["pgrep", "-P", str(pid), "-f", "spawn_main"], capture_output=True, text=True, check=False)
    return [int(line) for line in found.stdout.split()]


def _count_complete(out: Path) -> int:
    """Return the number of results; exit with a message if an overlay is damaged."""
    paths = sorted((out / "frames").glob("*.json"))
    for path in paths:
        json.loads(path.read_text(encoding="utf-8"))
        overlay = np.frombuffer((out / "overlays" / f"{path.stem}.jpg").read_bytes(), np.uint8)
        if cv2.imdecode(overlay, cv2.IMREAD_COLOR) is None:
            raise SystemExit(f"kill_batch.py: {path.stem}: its overlay is damaged")
    return len(paths)


def _differences(one: Path, other: Path) -> list[str]:
    """Return the names of the files that are not in both folders with the same content, times excluded."""
    first, second = _contents(one), _contents(other)
    return sorted(name for name in {*first, *second} if first.get(name) != second.get(name))


def _contents(out: Path) -> dict[str, bytes]:
    """Return the contents of the files of a folder of results by name, without times."""
    contents = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    del contents["report.html"]  # contains times in many places
    contents["summary.json"] = re.sub(rb'"timing": \{.*?\n \},', b"", contents["summary.json"], flags=re.DOTALL)
    table = [line.split(b",") for line in contents["poses.csv"].splitlines()]
    at = table[0].index(b"seconds")
    contents["poses.csv"] = b"\n".join(b",".join(line[:at] + line[at + 1 :]) for line in table)
    return {
        name: re.sub(rb'"seconds": [0-9.]+,', b"", text) if name.startswith("frames") else text
        for name, text in contents.items()
    }


if __name__ == "__main__":
    sys.exit(main())
