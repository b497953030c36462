"""Measure the quality of masks found in images, on session folders with images and masks. To be run by hand.

    python scripts/segmentation.py masks SESSION...    overlap with the given masks, by prompt; CPU seconds an image
    python scripts/segmentation.py poses SESSION...    poses from the image alone, compared with those from the masks
    python scripts/segmentation.py predicted session.json...
        first masks of a calibrated session that overlap the silhouettes predicted by the other frames, counted by image
    python scripts/segmentation.py pictures FRAMES [--groups jhu,endovis17,...] [--predicted DIR] [--drawn 12] [--poses]
        masks of pictures of several laboratories in ../shared/frames, found by the instrument's model, and of drawn
        ones: how right they are, how sure, and CPU seconds; with the half by which settings were tuned and the other
        half apart. With --poses the masks and poses that `estimate` finds in them
    python scripts/segmentation.py fit 20 [--seed 1000]
        the weights of ``segment/by_model.py`` by which a candidate's confidence follows, fitted to drawn pictures, and
        how sure and how right candidates of as many other drawn pictures are

``poses`` needs the session's camera, its readings and --instrument.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from measure.pictures import GROUPS, Picture, found_in, read_pictures
from measure.tables import Report, add_output_options, print_report
from numpy.typing import NDArray
from scipy.special import expit

from dvrk_cmaes.calibration.document import SessionCalibration, read_calibration
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.evaluate.pose_error import compare_poses
from dvrk_cmaes.evidence.gather import window_around
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.frames.packed_mask import overlap_of
from dvrk_cmaes.frames.session_folder import Session, read_session
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import read_any_frame, solve_frame
from dvrk_cmaes.segment import Segmentation, segment
from dvrk_cmaes.segment.sizes import resized
from dvrk_cmaes.silhouette import Body, Renderer
from dvrk_cmaes.silhouette.prepare import prepare

Bool = NDArray[np.bool_]
Rows = list[dict[str, Any]]

NEAR_MM: Final = 5.0
NEAR_DEG: Final = 10.0
OVERLAP: Final = 0.85
RIGHT: Final = 0.8
SURE: Final = 0.8
RIGHT_POSE: Final = 0.5
RIGHT_DEG: Final = 4.0
_RIDGE: Final = 0.5
_DRAWN: Final = 2000  # first seed of drawn pictures that are measured


def main() -> int:
    """Run a command and print its report; return the exit code."""
    options = _parser().parse_args()
    return print_report("segmentation.py", lambda: _report(options), as_json=options.json, kept=options.record)


def _report(options: argparse.Namespace) -> Report:
    """Return the report of a command."""
    if options.command == "fit":
        count = str(options.sessions[0])
        if not count.isdecimal():
            raise InputError(f"fit: expected a number of pictures, got {count}")
        return fit_report(int(count), options.seed)
    if options.command == "pictures":
        groups = options.groups.split(",") if options.groups else []
        found = (
            itertools.islice(read_pictures(options.sessions[0], [group], options.predicted), options.most)
            for group in groups
        )
        pictures = itertools.chain(itertools.chain.from_iterable(found), _drawn(options.drawn))
        return pictures_report(pictures, poses=options.poses)
    if options.command == "predicted":
        return predicted_report({str(path): read_calibration(path) for path in options.sessions})
    sessions = {"/".join(folder.absolute().parts[-2:]): read_session(folder) for folder in options.sessions}
    return {"masks": masks_report, "poses": poses_report}[options.command](sessions, options.instrument)


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("masks", "poses", "predicted", "pictures", "fit"), help="what to measure")
    parser.add_argument(
        "sessions", nargs="+", type=Path, metavar="SESSION", help="session folders, session.json, or a number"
    )
    parser.add_argument("--instrument", default="lnd", metavar="NAME|URDF", help="for poses: instrument (default: lnd)")
    parser.add_argument("--groups", default=",".join(GROUPS), help="for pictures: groups of them, and bench")
    parser.add_argument("--predicted", type=Path, help="for pictures of the bench: folder of silhouettes by eye")
    parser.add_argument("--most", type=int, help="for pictures: number of a group's, at most (default: all)")
    parser.add_argument("--drawn", type=int, default=0, help="for pictures: number of drawn ones (default: none)")
    parser.add_argument("--poses", action="store_true", help="for pictures: masks and poses as by estimate")
    parser.add_argument("--seed", type=int, default=1000, help="for fit: first seed (default: 1000)")
    add_output_options(parser)
    return parser


def _box(mask: Bool) -> dict[str, Any]:
    """Return the bounding box of a mask as a prompt."""
    left, top, width, height = window_around(mask, 0)
    return {"box": (left, top, left + width - 1, top + height - 1)}


def _point(mask: Bool) -> dict[str, Any]:
    """Return a point prompt as a user would click: the point of the mask that is farthest from its contour."""
    inside = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    v, u = np.unravel_index(int(inside.argmax()), inside.shape)
    return {"points": [(float(u), float(v))]}


PROMPTS: Final[Mapping[str, Callable[[Bool], dict[str, Any]]]] = {"box": _box, "point": _point, "none": lambda _: {}}


def masks_report(sessions: Mapping[str, Session], _: str) -> dict[str, Rows]:
    """Report the overlap with the given masks and the CPU seconds, by session and prompt, and of each image."""
    rows: Rows = []
    frames: Rows = []
    for name, session in sessions.items():
        for prompt, made in PROMPTS.items():
            found = [_mask_row(session, files, prompt, made) for files in session.frames]
            frames += [{"session": name, **row} for row in found]
            overlaps, seconds = ([row[key] for row in found] for key in ("iou", "cpu_seconds"))
            rows.append(
                {
                    "session": name,
                    "prompt": prompt,
                    "images": len(found),
                    "iou, mean": float(np.mean(overlaps)),
                    "iou, least": float(np.min(overlaps)),
                    "confidence, least": float(np.min([row["confidence"] for row in found])),
                    "cpu s, mean": float(np.mean(seconds)),
                    "cpu s, most": float(np.max(seconds)),
                }
            )
    return {"masks": rows, "images": frames}


def _drawn(count: int, seed: int = _DRAWN) -> Iterator[Picture]:
    """Yield the drawn pictures of some seeds; by those from `_DRAWN` on no setting was chosen."""
    from measure.drawn_pictures import drawn_picture

    yield from (picture for picture in map(drawn_picture, range(seed, seed + count)) if picture is not None)


def _posed(picture: Picture) -> tuple[Segmentation, bool | None, str]:
    """Find a picture's mask and pose as `estimate` does; return the mask, whether the pose is right, and its status.

    Right is a silhouette that shows an instrument as masks do, or a shaft within 4 deg; None where nothing is known.
    """
    body, shape = prepare(picture.instrument), picture.image.shape[:2]
    try:
        found = found_in(picture, body)
    except DvrkCmaesError:
        return Segmentation(np.zeros(shape, np.bool_), None, 0.0), False, "failed"
    mask, result = found.segmentation, found.result
    if result.camera_from_root is None:
        return mask, False, result.status
    at = np.array([result.joints[name] for name in body.instrument.joint_names])
    shown = picture.shows(Renderer(body, picture.camera).masks(result.camera_from_root, at))
    if shown is not None:
        return mask, shown >= RIGHT, result.status
    if picture.axis is None:
        return mask, None, result.status
    cosine = result.camera_from_root[:3, 2] @ picture.axis / np.linalg.norm(picture.axis)
    return mask, bool(np.degrees(np.arccos(min(abs(float(cosine)), 1.0))) < RIGHT_DEG), result.status


def pictures_report(pictures: Iterable[Picture], *, poses: bool = False) -> dict[str, Rows]:
    """Report how right the masks of pictures of several laboratories are, by group and half, and of each picture.

    Right is an overlap with an instrument's mask of 0.8, or that share of its labelled pixels near the outline.
    """
    found: Rows = []
    for picture in pictures:
        started = time.process_time()
        right, status = None, None
        if poses:
            mask, right, status = _posed(picture)
        else:
            mask = segment(picture.image, instrument=picture.instrument, camera=picture.camera, joints=picture.joints)
        seconds = time.process_time() - started
        every = [mask.mask, *(other.mask for other in mask.others)]
        found.append(
            {
                "group": picture.group,
                "half": "tuned" if picture.tuned else "other",
                "picture": picture.name,
                "right": picture.shows(mask.mask),
                "confidence": mask.confidence,
                "instruments": len(every),
                "pose right": right,
                "status": status,
                "jaws": f"{picture.jaws_found(every)} of {len(picture.points)}" if picture.points else None,
                "cpu_seconds": seconds,
            }
        )
    rows: Rows = []
    for group, half in dict.fromkeys((row["group"], row["half"]) for row in found):
        own = [row for row in found if (row["group"], row["half"]) == (group, half)]
        known = [row for row in own if row["right"] is not None]
        rows.append(
            {
                "group": group,
                "half": half,
                "pictures": len(own),
                "with truth": len(known),
                "right, mean": float(np.mean([row["right"] for row in known])) if known else None,
                "right, least": min((row["right"] for row in known), default=None),
                "wrong above .8": sum(row["right"] < RIGHT and row["confidence"] > SURE for row in known),
                "poses right": sum(bool(row["pose right"]) for row in own) if poses else None,
                "ok and wrong": sum(row["pose right"] is False and row["status"] == "ok" for row in own)
                if poses
                else None,
                "cpu s, mean": float(np.mean([row["cpu_seconds"] for row in own])),
            }
        )
    return {"pictures": rows, "each": found}


def fit_report(count: int, seed: int) -> dict[str, Rows]:
    """Report weights of a candidate's measures fitted to drawn pictures from a seed on, and those of as many others."""
    measures, right = drawn_candidates(count, seed)
    known, truth = drawn_candidates(count, seed + count)
    inputs = np.c_[measures, np.ones(len(measures))]
    weights = np.zeros(inputs.shape[1])
    ridge = _RIDGE * np.diag([1.0] * (inputs.shape[1] - 1) + [0.0])
    for _ in range(30):
        chance = expit(inputs @ weights)
        slope = inputs.T @ (right - chance) - ridge @ weights
        weights += np.linalg.solve(inputs.T @ (inputs * (chance * (1 - chance))[:, None]) + ridge, slope)
    rows: Rows = []
    for name, own, of in (("fitted", measures, right), ("others", known, truth)):
        chance = expit(np.c_[own, np.ones(len(own))] @ weights)
        for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 1.0)):
            among = (chance >= low) & (chance <= high)
            share = float(of[among].mean()) if among.any() else None
            rows.append(
                {"pictures": name, "confidence": f"{low} to {high}", "number": int(among.sum()), "right": share}
            )
    return {"weights": [{"weights": ", ".join(f"{value:.2f}" for value in weights)}], "confidence": rows}


def drawn_candidates(count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the measures (N, 5) of the candidates in drawn pictures, and whether each is an instrument's, (N,)."""
    from dvrk_cmaes.segment.by_model import find_instruments

    measures, right = [], []
    for picture in _drawn(count, seed):
        outside = np.zeros(picture.image.shape[:2], np.bool_)
        body = prepare(picture.instrument)
        for found in find_instruments(picture.image, outside, body, picture.camera, picture.joints):
            height, width = found.silhouette.shape
            overlaps = [overlap_of(found.silhouette, resized(tool, (width, height))) for tool in picture.tools]
            measures.append(found.measures)
            right.append(float(max(overlaps, default=0.0) > RIGHT_POSE))
    return np.array(measures), np.array(right)


def _mask_row(
    session: Session, files: FrameFiles, prompt: str, made: Callable[[Bool], dict[str, Any]]
) -> dict[str, Any]:
    """Segment one image with a prompt, and compare the mask with the given one."""
    data = read_frame(files, session.camera)
    if data.image is None:
        raise InputError(f"frame {files.name}: expected an image beside the mask, got none")
    hints = made(data.mask)
    started = time.process_time()
    found = segment(data.image, **hints)
    return {
        "frame": files.name,
        "prompt": prompt,
        "iou": float((found.mask & data.mask).sum() / max((found.mask | data.mask).sum(), 1)),
        "confidence": found.confidence,
        "cpu_seconds": time.process_time() - started,
    }


def predicted_report(calibrations: Mapping[str, SessionCalibration]) -> dict[str, Rows]:
    """Count the images whose first mask overlaps the silhouette that the other frames predict, by session and eye.

    Frames that were left out have no prediction; their images count as not overlapping.
    """
    rows: Rows = []
    for name, calibration in calibrations.items():
        of_views = calibration.leave_one_out_of_views or {"one eye": calibration.leave_one_out}
        images = len(calibration.frames) + len(calibration.left_out)
        eyes = {view: np.array(list(own.values())).reshape(-1, 2) for view, own in of_views.items()}
        eyes |= {"all": np.concatenate(list(eyes.values()))} if len(eyes) > 1 else {}
        for view, pairs in eyes.items():
            rows.append(
                {
                    "session": name,
                    "eye": view,
                    "images": images * (len(of_views) if view == "all" else 1),
                    f"iou above {OVERLAP:g}": int((pairs[:, 0] > OVERLAP).sum()),
                    "iou, mean": round(float(pairs[:, 0].mean()), 3),
                    "iou, least": round(float(pairs[:, 0].min()), 3),
                    "contour px, median": round(float(np.median(pairs[:, 1])), 2),
                }
            )
    return {"predicted": rows}


def poses_report(sessions: Mapping[str, Session], instrument: str) -> dict[str, Rows]:
    """Report the differences between poses from the image alone and poses from the given masks."""
    body = prepare(instrument)
    rows: Rows = []
    frames: Rows = []
    for name, session in sessions.items():
        found = [_pose_row(session, files, body) for files in session.frames]
        frames += [{"session": name, **row} for row in found]
        near = [row["root_mm"] <= NEAR_MM and row["axis_deg"] <= NEAR_DEG for row in found]
        rows.append(
            {
                "session": name,
                "images": len(found),
                f"within {NEAR_MM:g} mm, {NEAR_DEG:g} deg": sum(near),
                "farther, not doubted": sum(
                    row["status"] == "ok" and not n for row, n in zip(found, near, strict=True)
                ),
                "root mm, median": float(np.median([row["root_mm"] for row in found])),
                "axis deg, median": float(np.median([row["axis_deg"] for row in found])),
                "iou, mean": float(np.mean([row["iou"] for row in found])),
                "cpu s, mean": float(np.mean([row["cpu_seconds"] for row in found])),
                "with the mask": float(np.mean([row["cpu_seconds_with_mask"] for row in found])),
            }
        )
    return {"poses": rows, "images": frames}


def _pose_row(session: Session, files: FrameFiles, body: Body) -> dict[str, Any]:
    """Estimate one frame from the image alone and from the given mask, and compare the poses."""
    given = read_frame(files, session.camera)
    begun = time.process_time()
    reference = _estimated(session, files, body, from_image=False)[0]
    started = time.process_time()
    result, mask = _estimated(session, files, body, from_image=True)
    seconds = time.process_time() - started
    assert result.camera_from_root is not None
    assert reference.camera_from_root is not None
    error = compare_poses(
        body.instrument, (result.camera_from_root, result.joints), (reference.camera_from_root, reference.joints)
    )
    return {
        "frame": files.name,
        "root_mm": error.root_mm,
        "axis_deg": error.shaft_deg,
        "iou": float((mask & given.mask).sum() / max((mask | given.mask).sum(), 1)),
        "status": result.status,
        "reasons": "; ".join(result.reasons),
        "cpu_seconds": seconds,
        "cpu_seconds_with_mask": started - begun,
    }


def _estimated(session: Session, files: FrameFiles, body: Body, *, from_image: bool) -> tuple[Result, Bool]:
    """Estimate a frame with the given mask, or from the image alone; return the result and the mask used."""
    files = replace(files, mask=None) if from_image else files
    frame = read_any_frame(files, session.camera)
    solved = solve_frame(files, frame, body, FrameMethod("classic", EstimateConfig()))
    return solved.result, solved.data.mask


if __name__ == "__main__":
    sys.exit(main())
