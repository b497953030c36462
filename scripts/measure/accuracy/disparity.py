"""Vertical disparity between the eyes of stereo sessions: how far apart the rows of one point are once rectified.

Points are matched between the two images of each frame by their SIFT features, without the masks. The rows are compared
after rectification by the rig of the session's files, and by that with which a calibration (--session) was solved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.camera import Rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.frame import FrameFiles
from dvrk_cmaes.frames.images import read_image
from measure.cases import Measurement

Float64 = NDArray[np.float64]

_RATIO: Final = 0.7  # of the distances of the best and the second best match
_LARGEST: Final = 10.0  # px of rows, beyond which a match is wrong
_FEWEST: Final = 20  # matches of a frame


def disparity_report(given: Measurement, calibration: SessionCalibration | None) -> dict[str, list[dict[str, Any]]]:
    """Return the vertical disparities of stereo sessions with images, by the files' rig and by a calibration's.

    Raises
    ------
    InputError
        A session has one view, or too few points are matched.
    """
    rows = []
    for one in given.recordings():
        session = one.session
        if len(session.rig.views) == 1:
            raise InputError(f"{session.folder}: expected a stereo session (images/left, images/right), got one view")
        pairs = list(_matched(session.frames, session.rig))
        if not pairs:
            raise InputError(f"{session.folder}: expected points that match between the eyes, got too few")
        rigs = {"file": session.rig}
        if calibration is not None:
            rigs["calibration"] = Rig(calibration.corrected_views(session.rig.views))
        for name, rig in rigs.items():
            of_frames = [_rows_apart(rig, *pair) for pair in pairs]
            apart = np.concatenate(of_frames)
            rows.append(
                {
                    "session": one.name,
                    "rig": name,
                    "frames": len(pairs),
                    "points": len(apart),
                    "median of all, px": round(float(np.median(apart)), 2),
                    "median size, px": round(float(np.median(np.abs(apart))), 2),
                    "90 % size, px": round(float(np.percentile(np.abs(apart), 90)), 2),
                    "median size of frames' medians, px": round(
                        float(np.median([abs(np.median(own)) for own in of_frames])), 2
                    ),
                }
            )
    return {"vertical disparity, left minus right": rows}


def _matched(frames: Sequence[FrameFiles], rig: Rig) -> Iterator[tuple[Float64, Float64]]:
    """Yield the pixels (N, 2) of matched points in the left and the right image of each frame."""
    finder, matcher = cv2.SIFT.create(), cv2.BFMatcher()
    for files in frames:
        paths = [own.image for own in files.of_views(rig).values() if own.image is not None]
        if len(paths) < 2:
            continue
        images = [cv2.cvtColor(read_image(path), cv2.COLOR_BGR2GRAY) for path in paths]
        (points, features), (others, described) = (finder.detectAndCompute(image, None) for image in images)
        if features is None or described is None:
            continue
        best = [pair for pair in matcher.knnMatch(features, described, k=2) if len(pair) == 2]
        back = {match.queryIdx: match.trainIdx for match in matcher.match(described, features)}
        clear = [a for a, b in best if a.distance < _RATIO * b.distance and back.get(a.trainIdx) == a.queryIdx]
        left = np.array([points[match.queryIdx].pt for match in clear]).reshape(-1, 2)
        right = np.array([others[match.trainIdx].pt for match in clear]).reshape(-1, 2)
        near = np.abs(left[:, 1] - right[:, 1]) < _LARGEST
        if near.sum() >= _FEWEST:
            yield left[near], right[near]


def _rows_apart(rig: Rig, left: Float64, right: Float64) -> Float64:
    """Return by how much the rows (N,) of matched points differ once they are rectified by a rig, px."""
    first, second = rig.views
    along = second.camera_from_view[:3, 3] / np.linalg.norm(second.camera_from_view[:3, 3])
    down = np.cross(np.cross(along, [0.0, 1.0, 0.0]), along)
    down /= np.linalg.norm(down)
    forward = np.cross(along, down)
    rows = []
    for view, pixels in ((first, left), (second, right)):
        ahead = np.concatenate([view.camera.normalise(pixels), np.ones((len(pixels), 1))], axis=1)
        rays = ahead @ view.camera_from_view[:3, :3].T
        rows.append(first.camera.fy * (rays @ down) / (rays @ forward))
    return np.asarray(rows[0] - rows[1], np.float64)
