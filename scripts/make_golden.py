"""Write the golden cases data/golden: single masks of the bundled needle driver with truth and tolerances.

    python scripts/make_golden.py

The tests estimate each case and compare it with the truth. Plain cases must be within tolerance; difficult ones (the
shaft seen nearly end-on, hidden jaws, ...) may be doubtful instead. The script refuses to run in CI.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from committed_data import fixed_rms_readings, refuse_in_ci
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.evaluate import Tolerance
from dvrk_cmaes.frames.truth import truth_entry
from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.io.json_file import write_image, write_json
from dvrk_cmaes.synth.levels import Mistakes
from dvrk_cmaes.synth.masks import MEDIUM, SLIGHT, simulate_segmentation
from dvrk_cmaes.synth.occluders import dilate_region, tissue_over_jaw
from dvrk_cmaes.synth.scene import exact_mask
from dvrk_cmaes.synth.truth import Truth, pose_from_view

OUT: Final = Path(__file__).resolve().parents[1] / "data" / "golden"
SCHEMA: Final = 1

ENDOSCOPE: Final = Camera(640, 480, fx=1030.0, fy=1030.0, cx=318.2, cy=243.7)
DISTORTED: Final = Camera(640, 480, 760.0, 760.0, 322.4, 236.6, (-0.31, 0.13, 0.0006, -0.0009, 0.0))
OFF_CENTRE: Final = Camera(720, 576, fx=858.9, fy=934.9, cx=445.0, cy=251.0)

Outcome = Literal["ok", "doubtful", "ok-or-doubtful"]


SHARP: Final = Tolerance()
ROUGH: Final = Tolerance(root_mm=2.0, tip_mm=1.5, shaft_deg=5.0, roll_deg=12.0, pitch_yaw_deg=8.0, jaw_deg=8.0)
LOOSE: Final = Tolerance(root_mm=3.0, tip_mm=3.0, shaft_deg=8.0, roll_deg=20.0, pitch_yaw_deg=15.0, jaw_deg=20.0)


@dataclass(frozen=True)
class Case:
    """One golden case. Angles in degrees, lengths in mm, pixels; see ``dvrk_cmaes.synth.truth.pose_from_view``.

    ``read`` states whether it has readings; ``reason`` is a word that the reasons contain if the result is doubtful.
    """

    about: str
    wrist: tuple[float, float]
    depth: float
    tilt: float
    heading: float
    roll: float
    joints: tuple[float, float, float]
    camera: Camera = ENDOSCOPE
    mistakes: Mistakes | None = None
    occluded: bool = False
    read: bool = True
    tolerance: Tolerance = SHARP
    outcome: Outcome = "ok"
    reason: str = ""


CASES: Final[dict[str, Case]] = {
    "clean_1": Case("open jaws, from the right", (300, 250), 110, 62, 165, 150, (-32, 28, 45)),
    "clean_2": Case("bent wrist, from below", (330, 215), 128, 50, -75, -70, (48, -24, 25)),
    "clean_3": Case("near, from the upper left", (290, 200), 84, 66, 40, 120, (20, 44, 32)),
    "wavy_1": Case(
        "a segmenter's outline, with highlights missing",
        *((360, 240), 106, 58, 185, -35, (36, 25, 52)),
        mistakes=MEDIUM,
        tolerance=ROUGH,
    ),
    "wavy_2": Case(
        "a segmenter's outline, with highlights missing",
        *((280, 260), 118, 64, -30, 130, (-42, -30, 38)),
        mistakes=MEDIUM,
        tolerance=ROUGH,
    ),
    "distorted_lens": Case(
        "straight edges are bent by the lens",
        *((205, 380), 82, 60, 170, 30, (34, -36, 48)),
        camera=DISTORTED,
    ),
    "off_centre": Case(
        "pixels that are not square, principal point far from the middle",
        *((280, 330), 105, 57, 150, -110, (-28, 40, 40)),
        camera=OFF_CENTRE,
    ),
    "occluded": Case(
        "tissue before one jaw, given as pixels to ignore",
        *((330, 235), 104, 60, 20, -15, (25, 32, 58)),
        mistakes=SLIGHT,
        occluded=True,
        tolerance=ROUGH,
    ),
    "foreshortened": Case(
        "the shaft 15 deg off the optical axis",
        *((300, 235), 112, 15, 140, 60, (40, 35, 45)),
        tolerance=ROUGH,
        outcome="ok-or-doubtful",
        reason="shaft",
    ),
    "jaws_edge_on": Case(
        "closed jaws seen edge-on: the jaw angle hardly shows",
        *((310, 230), 108, 60, -160, 109, (30, 28, 0)),
        tolerance=ROUGH,
        outcome="ok-or-doubtful",
        reason="jaw",
    ),
    "jaws_hidden": Case(
        "jaws behind the wrist, which is bent away from the camera",
        *((300, 240), 110, 62, 30, 0, (-62, 6, 20)),
        tolerance=LOOSE,
        outcome="ok-or-doubtful",
        reason="jaw",
    ),
    "tip_outside": Case(
        "one tip beyond the border",
        *((470, 250), 96, 62, 10, 50, (30, 30, 55)),
        tolerance=ROUGH,
        outcome="ok-or-doubtful",
        reason="tip",
    ),
    "close_up": Case(
        "hardly any shaft in view",
        *((545, 250), 62, 64, 178, 35, (28, -34, 42)),
        tolerance=ROUGH,
        outcome="ok-or-doubtful",
        reason="shaft",
    ),
    "no_readings": Case(
        "no readings: nothing distinguishes the pose from its mirror twin",
        *((310, 245), 110, 58, -20, -50, (34, -30, 44)),
        read=False,
        outcome="doubtful",
        reason="twin",
    ),
}


def truth_of(case: Case, instrument: Instrument) -> Truth:
    """Return the true pose and joints of a case."""
    pose = pose_from_view(
        case.camera,
        wrist=case.wrist,
        depth=case.depth * 1e-3,
        tilt=np.deg2rad(case.tilt),
        heading=np.deg2rad(case.heading),
        roll=np.deg2rad(case.roll),
    )
    joints = dict(zip(instrument.joint_names, np.deg2rad(case.joints), strict=True))
    return Truth(instrument, pose, joints)


def masks_of(case: Case, truth: Truth, rng: np.random.Generator) -> tuple[NDArray[np.bool_], NDArray[np.bool_] | None]:
    """Return the mask of a case, and the pixels to ignore if tissue covers the tool, (H, W) each."""
    occluder = tissue_over_jaw(case.camera, truth, rng) if case.occluded else None
    mask = exact_mask(case.camera, truth)
    if case.mistakes is not None:
        mask = simulate_segmentation(mask, rng, case.mistakes, occluder).mask
    if occluder is None:
        return mask, None
    return mask, dilate_region(occluder)


def entry(name: str, case: Case, truth: Truth, rng: np.random.Generator) -> dict[str, Any]:
    """Return the entry of a case in golden.json."""
    reading, stated = fixed_rms_readings([truth], rng)[0] if case.read else {}, truth_entry(truth.stated)
    return {
        "about": case.about,
        "camera": {**asdict(case.camera), "distortion": list(case.camera.distortion)},
        "mask": f"masks/{name}.png",
        "ignore": f"ignore/{name}.png" if case.occluded else None,
        "readings": {joint: round(float(value), 6) + 0.0 for joint, value in reading.items()},
        "truth": {"camera_from_root": stated.pop("T_camera_roll_link"), **stated},
        "tolerance": asdict(case.tolerance),
        "outcome": case.outcome,
        "reason": case.reason or None,
        "either_twin": not case.read,
    }


def main() -> int:
    """Write masks and golden.json; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=OUT, metavar="DIR", help="folder to write (default: data/golden)")
    arguments = parser.parse_args()
    refuse_in_ci("make_golden.py")
    out: Path = arguments.out
    instrument = load_instrument("lnd")
    entries = {}
    for number, (name, case) in enumerate(CASES.items()):
        rng = np.random.default_rng([20, number])  # for each case, so that a change of one does not change others
        truth = truth_of(case, instrument)
        mask, ignore = masks_of(case, truth, rng)
        write_image(out / "masks" / f"{name}.png", mask)
        if ignore is not None:
            write_image(out / "ignore" / f"{name}.png", ignore)
        entries[name] = entry(name, case, truth, rng)
    write_json(out / "golden.json", {"schema": SCHEMA, "instrument": "lnd", "cases": entries})
    return 0


if __name__ == "__main__":
    sys.exit(main())
