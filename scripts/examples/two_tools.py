"""Estimate two tools in one frame, each without what the other may hide of it, and keep the results in files.

    dvrk-cmaes synth both --arms 2 --level easy --frames 1 --seed 2
    python scripts/examples/two_tools.py both results

The arguments are a session folder of two arms, whose masks have the labels 1 and 2, and a folder to write to.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import cv2
import numpy as np

from dvrk_cmaes import InputError, ToolInFrame, estimate_tools, load_instrument, read_camera, read_result, read_results


def main(folder: str, out: str) -> None:
    labels = cv2.imread(str(Path(folder, "masks", "0000.png")), cv2.IMREAD_GRAYSCALE)
    instrument = load_instrument("lnd")  # or the path of a URDF
    tools = {}
    for label, arm in enumerate(("PSM1", "PSM2"), start=1):
        with Path(folder, f"joints_{arm}.csv").open(encoding="utf-8", newline="") as file:
            row = next(csv.DictReader(file))  # of frame 0000
        readings = {name: float(value) for name, value in row.items() if name != "frame"}  # rad, of the insertion m
        tools[arm] = ToolInFrame(np.asarray(labels == label), readings, instrument)

    results = estimate_tools(tools, read_camera(Path(folder, "camera.yaml")), frame="0000")

    for arm, result in results.items():
        print(f"{arm}: {result.status}", *result.reasons, sep="; ")
        path = Path(out, arm, "frames", "0000.json")
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(result.to_dict()), encoding="utf-8")
        assert read_result(path).joints.keys() == result.joints.keys()
        for cells in read_results(Path(out, arm)).to_rows():  # or to_frame(), with pandas
            print(f"  depth of the wrist: {cells['camera_from_root_z_mm']:.1f} mm")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        print("expected a session folder of two arms, and a folder to write to", file=sys.stderr)
        sys.exit(2)
    try:
        main(*sys.argv[1:])
    except (InputError, OSError) as error:
        print(error, file=sys.stderr)
        sys.exit(2)
