"""Seconds and memory of whole commands, from start to exit, of this checkout and, in turns, of another one."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.errors import InputError
from measuring.report import ROOT, Report

_DONE: Final = (0, 3)  # exit codes
_EVERY: Final = 5  # frame of the recording


def speed_report(options: argparse.Namespace) -> Report:
    """Measure commands on a session and a recording with masks; the first run of each checkout is not measured.

    Of each command the median of ``repeats`` runs is given, of those that take long that of a quarter of these.
    """
    session, repeats = options.session, options.repeats
    checkouts = {"this": ROOT} | ({} if options.against is None else {"other": options.against.resolve()})
    first = sorted((session / "masks").iterdir())[0]
    given = ["--camera", str(session / "camera.yaml"), "--joints", str(session / "joints.csv")]
    lines: dict[str, tuple[list[str], int]] = {
        "--help": (["--help"], repeats),
        "inspect, a camera file": (["inspect", str(session / "camera.yaml")], repeats),
        "estimate, a frame": (["estimate", "--mask", str(first), *given, "--json"], repeats),
        "batch, two workers": (["batch", str(session), "--workers", "2", "--out"], max(repeats // 4, 1)),
        "calibrate": (["calibrate", str(session), "--workers", "1", "--out"], max(repeats // 4, 1)),
        f"track, every {_EVERY}th frame": (
            ["track", str(options.recording), "--every", str(_EVERY), "--no-video", "--no-page", "--out"],
            max(repeats // 4, 1),
        ),
    }
    rows = []
    for name, (line, count) in lines.items():
        of_tool = [] if line[0] in ("--help", "inspect") else ["--instrument", options.instrument]
        times: dict[str, list[tuple[float, float, float]]] = {checkout: [] for checkout in checkouts}
        for _ in range(count + 1):
            for checkout, folder in checkouts.items():
                times[checkout].append(_timed(folder, line, of_tool))
        medians = {checkout: np.median(own[1:], axis=0).tolist() for checkout, own in times.items()}
        row: dict[str, Any] = {"command": name, "runs": count}
        for checkout, own in medians.items():
            said = "" if len(checkouts) == 1 else f"{checkout}: "
            row |= dict(zip((f"{said}wall, s", f"{said}processor, s", f"{said}MB"), own, strict=True))
        if "other" in medians:
            row["ratio of processor time"] = medians["this"][1] / medians["other"][1]
        rows.append(row)
    return {"whole commands": rows}


def _timed(checkout: Path, line: Sequence[str], options: Sequence[str]) -> tuple[float, float, float]:
    """Run a command of a checkout; return seconds by the clock and of its processor, and its largest memory, MB."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    python = sys.executable if checkout == ROOT else checkout / ".venv" / "bin" / "python"
    with tempfile.TemporaryDirectory() as place:
        arguments = [*line, *([f"{place}/out"] if line[-1] == "--out" else []), *options]
        command, began = [python, "-m", "dvrk_cmaes", *arguments], time.perf_counter()
        with open(f"{place}/stderr.txt", "w+") as err:
            process = subprocess.Popen(command, env=environment, cwd=place, stdout=subprocess.DEVNULL, stderr=err)
            _, status, used = os.wait4(process.pid, 0)
            wall, process.returncode = time.perf_counter() - began, os.waitstatus_to_exitcode(status)
            err.seek(0)
            said = err.read().strip()[-300:]
    if process.returncode not in _DONE:
        raise InputError(f"{checkout}: {' '.join(arguments)}: {said}")
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3
