"""Calibrate a session: one pose of the arm's base in the camera and the joints' offsets, from all frames together.

    python scripts/examples/calibrate_session.py data/demo session.json

The arguments are a session folder, whose readings have the outer joints, and the file to write.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from dvrk_cmaes import (
    InputError,
    SessionFrame,
    calibrate_session,
    estimate,
    prepare,
    read_calibration,
    read_frame,
    read_session,
)


def main(folder: str, out: str) -> None:
    session, body = read_session(folder), prepare("lnd")
    frames = []
    for files in session.frames:
        data = read_frame(files, session.camera)
        result = estimate(data.mask, data.camera, files.readings, body, frame=files.name)
        frames.append(SessionFrame(files.name, data, result, time=files.time))

    solved = calibrate_session(frames, body, series=session.reading_series())

    found = solved.calibration
    print(f"{found.status}: {len(found.frames)} frames agree", *found.warnings, sep="\n")
    for name, why in found.left_out.items():
        print(f"left out: {name}: {why}")
    print("camera_from_base, m:", np.array2string(found.camera_from_base, precision=4, suppress_small=True), sep="\n")
    for name, offset in found.offsets.items():
        print(f"{name}: true = reading {offset:+.4f}")  # rad, of the insertion m
    Path(out).write_text(json.dumps(found.to_dict(), indent=1), encoding="utf-8")

    # a further frame starts from the calibration, here the first one again
    first = frames[0]
    data = read_frame(session.frames[0], session.camera)
    again = estimate(data.mask, data.camera, first.result.readings, body, session=read_calibration(out))
    print(f"{first.name} with the calibration: {again.status}, solved from the {again.source}")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        print("expected a session folder with readings of the outer joints, and the file to write", file=sys.stderr)
        sys.exit(2)
    try:
        main(*sys.argv[1:])
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(2)
