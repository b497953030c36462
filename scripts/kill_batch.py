"""Kill a batch by SIGKILL at random moments, go on each time, and compare what is there in the end.

    python scripts/kill_batch.py --kills 20 --frames 60

Every other victim is one of its workers. After each kill all results that are there must be whole; in the end all
files must be those of a batch that nobody disturbed, byte for byte but for times. Exit code 1 if not.
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
from many_frames import multiplied_session

from dvrk_cmaes.io.bundled import bundled_path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--session", type=Path, default=bundled_path("demo"), help="whose frames are used")
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--longest", type=float, default=8.0, help="seconds until a kill, at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("options", nargs="*", help="of dvrk-cmaes batch, after --")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as place:
        session = multiplied_session(arguments.session, Path(place, "session"), arguments.frames)
        command = [sys.executable, "-m", "dvrk_cmaes", "batch", str(session), *arguments.options, "--out"]
        calm, disturbed = Path(place, "calm"), Path(place, "disturbed")
        _finish([*command, str(calm)])
        kills, counts = 0, []
        while kills < arguments.kills:
            kills += _killed([*command, str(disturbed)], rng.uniform(0, arguments.longest), worker=kills % 2 == 1)
            counts.append(_check_whole(disturbed))
            print(f"{kills} kills: {counts[-1]} results, all whole", file=sys.stderr)
        _finish([*command, str(disturbed)])
        differ = _differences(calm, disturbed)
    print(json.dumps({"kills": kills, "results after each": counts, "files that differ": differ}, indent=1))
    return 1 if differ else 0


def _finish(command: Sequence[str]) -> None:
    code = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False).returncode
    if code not in (0, 3):
        raise SystemExit(f"kill_batch.py: {' '.join(command)} ended with exit code {code}")


def _killed(command: Sequence[str], seconds: float, *, worker: bool) -> bool:
    """Run a batch and kill it, or a worker first, after so many seconds; False if it had ended by then."""
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
    """List the processes that a batch has started for frames."""
    found = subprocess.run(["pgrep", "-P", str(pid), "-f", "spawn_main"], capture_output=True, text=True, check=False)
    return [int(line) for line in found.stdout.split()]


def _check_whole(out: Path) -> int:
    """Count results, each of which must be whole and have its overlay."""
    paths = sorted((out / "frames").glob("*.json"))
    for path in paths:
        json.loads(path.read_text(encoding="utf-8"))
        overlay = np.frombuffer((out / "overlays" / f"{path.stem}.jpg").read_bytes(), np.uint8)
        if cv2.imdecode(overlay, cv2.IMREAD_COLOR) is None:
            raise SystemExit(f"kill_batch.py: {path.stem}: its overlay is damaged")
    return len(paths)


def _differences(one: Path, other: Path) -> list[str]:
    """Names of files that are not in both folders with the same content but for times."""
    first, second = _contents(one), _contents(other)
    return sorted(name for name in {*first, *second} if first.get(name) != second.get(name))


def _contents(out: Path) -> dict[str, bytes]:
    """Contents of the files of a folder of results, times cut out."""
    contents = {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*") if p.is_file()}
    del contents["report.html"]  # times all over
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
