"""Masks and poses found in images of several laboratories, against what is known of these.

The images are those of ../shared/frames, read by group. Half of each group was used to choose settings (``tuned``). A
mask is right if its overlap with an instrument's mask is 0.8, or that share of its labelled pixels is near the outline.
With poses, mask and pose are found as `estimate --image` does; a pose is right if its silhouette shows an instrument as
masks do, or if its shaft is within 4 deg of the one that both eyes see.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import read_camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.estimation.image_frame import segment_and_estimate
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.frames.images import read_ignore, read_image, read_mask
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.segment import Segmentation, segment
from dvrk_cmaes.silhouette import Renderer
from dvrk_cmaes.silhouette.prepare import prepare
from measuring.report import Report

Bool = NDArray[np.bool_]
Image = NDArray[np.uint8]

RIGHT: Final = 0.8
SURE: Final = 0.8
RIGHT_DEG: Final = 4.0
LEAST_TOOL: Final = 0.01
"""Share of an image of the smallest labelled piece that is an instrument by itself."""
_LABELLED_PX: Final = 10.0


@dataclass(frozen=True, eq=False)
class Picture:
    """An image, its camera, the joints that are read, and what is known of its instruments.

    tools : a mask (H, W) of each. points : labelled pixels (N, 2) on the outline of each. axis : direction (3,) of the
    shaft in the camera. ignore : (H, W), pixels that count neither way. tuned : whether settings may be chosen by it.
    """

    group: str
    name: str
    image: Image
    camera: Camera
    instrument: str
    tuned: bool
    joints: Mapping[str, float] = field(default_factory=dict)
    tools: tuple[Bool, ...] = ()
    points: tuple[NDArray[np.float64], ...] = ()
    axis: NDArray[np.float64] | None = None
    ignore: Bool | None = None

    def shows(self, mask: Bool) -> float | None:
        """Return how right a mask is, 0 to 1; None where nothing is known."""
        if self.tools:
            counts = np.ones_like(mask) if self.ignore is None else ~self.ignore
            pairs = (((mask & tool & counts).sum(), ((mask | tool) & counts).sum()) for tool in self.tools)
            return max(float(both / max(any_, 1)) for both, any_ in pairs)
        if self.points and mask.any() and not mask.all():
            away = np.abs(signed_distance(mask))
            last = [mask.shape[1] - 1, mask.shape[0] - 1]
            places = [np.clip(np.rint(points).astype(int), 0, last).T for points in self.points]
            return max(float(np.mean(away[v, u] <= _LABELLED_PX)) for u, v in places)
        return 0.0 if self.points else None


def _labelled(group: str, frames: Path, is_tool: Callable[[Image], Bool], camera: str) -> Iterator[Picture]:
    """Yield the pictures of a folder with labels, whose connected pieces are instruments."""
    folder = frames / "labs" / group
    for number, path in enumerate(sorted((folder / "images").glob("*.png"))):
        count, labels = cv2.connectedComponents(is_tool(read_image(folder / "labels" / path.name)).astype(np.uint8))
        pieces = tuple(labels == k for k in range(1, count))
        tools = tuple(piece for piece in pieces if piece.mean() >= LEAST_TOOL)
        yield Picture(
            *(group, path.stem, read_image(path), read_camera(folder / camera), "lnd"),
            (number % 2 == 1) == (group == "jhu"),
            tools=tools,
        )


def _ucsd19(frames: Path) -> Iterator[Picture]:
    """Yield pictures with labelled points of the left and the right instrument."""
    folder = frames / "labs/ucsd19"
    camera = read_camera(folder / "camera.xml", side="left")
    with (folder / "CollectedData_Ambar.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    parts = rows[1][1::2]
    for number, path in enumerate(sorted((folder / "images/left").glob("*.png"))):
        row = next((row for row in rows[3:] if row[0].endswith(path.name)), None)
        if row is None or not any(row[1:]):
            continue
        pixels = np.array([float(text or "nan") for text in row[1:]]).reshape(-1, 2)[: len(parts)]
        tools = []
        for side in ("left", "right"):
            own = pixels[[k for k, part in enumerate(parts) if part.startswith(side)]]
            edge = pixels[[k for k, part in enumerate(parts) if part.startswith(side) and part.endswith("jaw_edge")]]
            if not np.isnan(edge).any():
                tools.append(own[~np.isnan(own).any(axis=1)])
        yield Picture("ucsd19", path.stem, read_image(path), camera, "lnd", number % 2 == 0, points=tuple(tools))


def _lincoln(frames: Path) -> Iterator[Picture]:
    """Yield pictures of the left eye, some with masks by hand, some with the shaft that both eyes see."""
    folder = frames / "labs/lincoln"
    with (folder / "shaft_by_stereo.csv").open(encoding="utf-8") as file:
        axes = {row["frame"]: np.array([float(row[f"axis_{k}"]) for k in "xyz"]) for row in csv.DictReader(file)}
    instrument = str(next((frames.parent / "instruments/dvrk_model/urdf").glob("*400093*.urdf")))
    for picture in pictures_of("lincoln", folder, instrument):
        if picture.name.startswith("left/"):
            name = picture.name.removeprefix("left/")
            mask, ignore = (folder / "by_hand" / kind / f"{name}.png" for kind in ("masks", "ignore"))
            tools = (read_mask(mask),) if mask.exists() else ()
            border = read_ignore(ignore) if ignore.exists() else None
            yield replace(picture, name=name, tools=tools, ignore=border, axis=axes.get(name))


def pictures_of(group: str, folder: Path, instrument: str) -> Iterator[Picture]:
    """Yield the pictures of a session's views, with their masks where there are any."""
    session = read_session(folder)
    for number, files in enumerate(session.frames):
        for view, own in files.of_views(session.rig).items():
            assert own.image is not None
            tools = () if own.mask is None else (read_mask(own.mask),)
            name = f"{view}/{files.name}" if len(session.rig.names) > 1 else files.name
            camera, image = session.rig.view(view).camera, read_image(own.image)
            yield Picture(group, name, image, camera, instrument, number % 2 == 0, files.readings, tools)


def _real(frames: Path, level: str) -> Iterator[Picture]:
    urdf = frames.parent / "instruments/lnd_400006/lnd_400006.urdf"
    yield from pictures_of(level, frames / "real" / level, str(urdf))


GROUPS: Final[Mapping[str, Callable[[Path], Iterator[Picture]]]] = {
    "jhu": lambda frames: _labelled("jhu", frames, lambda label: (label == [0, 255, 0]).all(axis=2), "camera.yaml"),
    "endovis17": lambda frames: _labelled("endovis17", frames, lambda own: own.max(axis=2) != 0, "camera.yaml"),
    "ucsd19": _ucsd19,
    "lincoln": _lincoln,
    "easy": lambda frames: _real(frames, "easy"),
    "medium": lambda frames: _real(frames, "medium"),
}


def _posed(picture: Picture) -> tuple[Segmentation, bool | None, str]:
    """Find a picture's mask and pose as `estimate` does; return the mask, whether the pose is right, and its status."""
    body, shape = prepare(picture.instrument), picture.image.shape[:2]
    data = FrameData.of(np.zeros(shape, np.bool_), picture.camera, image=picture.image)
    data = replace(data, files=FrameFiles(picture.name, None, picture.joints))
    try:
        _, mask, result = segment_and_estimate(data, body, FrameMethod("classic", EstimateConfig()))
    except DvrkCmaesError:
        return Segmentation(np.zeros(shape, np.bool_), 0.0), False, "failed"
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


def pictures_report(options: argparse.Namespace) -> Report:
    """Report how right the masks (and poses) of pictures are, by group and half, and of each picture."""
    of_groups = (itertools.islice(GROUPS[group](options.frames), options.most) for group in options.groups)
    each = [_row(picture, poses=options.poses) for picture in itertools.chain(*of_groups)]
    rows = []
    for group, half in dict.fromkeys((row["group"], row["half"]) for row in each):
        own = [row for row in each if (row["group"], row["half"]) == (group, half)]
        known = [row for row in own if row["right"] is not None]
        row: dict[str, Any] = {"group": group, "half": half, "pictures": len(own), "with truth": len(known)}
        row["right, mean"] = float(np.mean([one["right"] for one in known])) if known else None
        row["right, least"] = min((one["right"] for one in known), default=None)
        row["wrong above .8"] = sum(one["right"] < RIGHT and one["confidence"] > SURE for one in known)
        if options.poses:
            row["poses right"] = sum(bool(one["pose right"]) for one in own)
            row["ok and wrong"] = sum(one["pose right"] is False and one["status"] == "ok" for one in own)
        rows.append(row | {"cpu s, mean": float(np.mean([one["cpu_seconds"] for one in own]))})
    return {"pictures": rows, "each": each}


def _row(picture: Picture, *, poses: bool) -> dict[str, Any]:
    """Find the mask, and with ``poses`` the pose of a picture; return what is right of it."""
    started, right, status = time.process_time(), None, None
    if poses:
        mask, right, status = _posed(picture)
    else:
        mask = segment(picture.image, instrument=picture.instrument, camera=picture.camera, joints=picture.joints)
    return {
        "group": picture.group,
        "half": "tuned" if picture.tuned else "other",
        "picture": picture.name,
        "right": picture.shows(mask.mask),
        "confidence": float(mask.confidence),
        "instruments": 1 + len(mask.others),
        "pose right": right,
        "status": status,
        "cpu_seconds": time.process_time() - started,
    }
