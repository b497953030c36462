"""Pictures of several laboratories with what is known of the instruments in them, read from ``frames``."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import read_camera
from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.estimation.image_frame import SegmentedFrame, segment_and_estimate
from dvrk_cmaes.estimation.one_tool import FrameMethod
from dvrk_cmaes.evidence.outline_noise import signed_distance
from dvrk_cmaes.frames.frame import FrameData, FrameFiles
from dvrk_cmaes.frames.images import read_ignore, read_image, read_mask
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.segment.segmentation import SegmentSettings
from dvrk_cmaes.silhouette import Body

Bool = NDArray[np.bool_]
Image = NDArray[np.uint8]

LEAST_TOOL: Final = 0.01
"""Share of an image of the smallest labelled piece that is an instrument by itself."""

_LABELLED_PX: Final = 10.0


@dataclass(frozen=True, eq=False)
class Picture:
    """An image, its camera, the joints that are read, and what is known of its instruments.

    tools : a mask (H, W) of each. points : labelled pixels (N, 2) on the outline of each, the jaws' edge first.
    axis : direction (3,) of the shaft in the camera. ignore : (H, W), pixels that count neither way.
    ``tuned`` tells whether settings may be chosen by it; figures are those of the others.
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

    def overlap(self, mask: Bool, tool: Bool) -> float:
        """Intersection over union of a mask and an instrument."""
        counts = np.ones_like(mask) if self.ignore is None else ~self.ignore
        return float((mask & tool & counts).sum() / max(((mask | tool) & counts).sum(), 1))

    def shows(self, mask: Bool) -> float | None:
        """Return how right a mask is, 0 to 1; None where nothing is known.

        It is the largest overlap with an instrument, or the share of an instrument's labelled pixels near its outline.
        """
        if self.tools:
            return max(self.overlap(mask, tool) for tool in self.tools)
        if self.points and mask.any() and not mask.all():
            away = np.abs(signed_distance(mask))
            return max(float(np.mean(_at(away, points) <= _LABELLED_PX)) for points in self.points)
        return 0.0 if self.points else None

    def jaws_found(self, masks: list[Bool]) -> int:
        """Return the number of instruments whose labelled jaws' edge is near the outline of one of the masks."""
        away = [np.abs(signed_distance(mask)) for mask in masks if mask.any() and not mask.all()]
        return sum(any(_at(each, points[:1])[0] <= _LABELLED_PX for each in away) for points in self.points)


def _at(image: NDArray[np.float32], pixels: NDArray[np.float64]) -> NDArray[np.float32]:
    u, v = np.clip(np.rint(pixels).astype(int), 0, [image.shape[1] - 1, image.shape[0] - 1]).T
    return np.asarray(image[v, u])


def pieces(labelled: Bool) -> tuple[Bool, ...]:
    """Return the connected pieces of labelled pixels (H, W) that are large enough to be an instrument."""
    count, labels = cv2.connectedComponents(labelled.astype(np.uint8))
    each = (labels == k for k in range(1, count))
    return tuple(piece for piece in each if piece.mean() >= LEAST_TOOL)


def _jhu(frames: Path) -> Iterator[Picture]:
    folder = frames / "labs/jhu"
    camera = read_camera(folder / "camera.yaml")
    for number, path in enumerate(sorted((folder / "images").glob("*.png"))):
        label = read_image(folder / "labels" / path.name)
        green = np.asarray((label == [0, 255, 0]).all(axis=2))
        yield Picture("jhu", path.stem, read_image(path), camera, "lnd", number % 2 == 1, tools=pieces(green))


def _endovis17(frames: Path) -> Iterator[Picture]:
    folder = frames / "labs/endovis17"
    camera = read_camera(folder / "camera.yaml")
    for number, path in enumerate(sorted((folder / "images").glob("*.png"))):
        label = read_image(folder / "labels" / path.name).max(axis=2)
        tools = pieces(np.not_equal(label, 0))
        yield Picture("endovis17", path.stem, read_image(path), camera, "lnd", number % 2 == 0, tools=tools)


def _ucsd19(frames: Path) -> Iterator[Picture]:
    folder = frames / "labs/ucsd19"
    camera = read_camera(folder / "camera.xml", side="left")
    with (folder / "CollectedData_Ambar.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))
    parts = rows[1][1::2]
    for number, path in enumerate(sorted((folder / "images/left").glob("*.png"))):
        row = next((row for row in rows[3:] if row[0].endswith(path.name)), None)
        if row is None or not any(row[1:]):
            continue
        pixels = np.array([[float(text or "nan") for text in row[1 + 2 * k : 3 + 2 * k]] for k in range(len(parts))])
        tools = []
        for side in ("left", "right"):
            own = [k for k, part in enumerate(parts) if part.startswith(side)]
            own.sort(key=lambda k: not parts[k].endswith("jaw_edge"))
            points = pixels[own]
            if not np.isnan(points[0]).any():
                tools.append(points[~np.isnan(points).any(axis=1)])
        yield Picture("ucsd19", path.stem, read_image(path), camera, "lnd", number % 2 == 0, points=tuple(tools))


def _lincoln(frames: Path) -> Iterator[Picture]:
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


def _real(frames: Path, level: str) -> Iterator[Picture]:
    yield from pictures_of(
        level, frames / "real" / level, str(frames.parent / "instruments/lnd_400006/lnd_400006.urdf")
    )


def _bench(frames: Path, predicted: Path | None) -> Iterator[Picture]:
    for picture in pictures_of("bench", frames / "bench/b", "lnd"):
        path = None if predicted is None else predicted / f"{picture.name}.png"
        yield picture if path is None or not path.exists() else replace(picture, tools=(read_mask(path),))


def pictures_of(group: str, folder: Path, instrument: str) -> Iterator[Picture]:
    """Yield the pictures of a session's views, with their masks where there are any."""
    session = read_session(folder)
    for number, files in enumerate(session.frames):
        for view, own in files.of_views(session.rig).items():
            assert own.image is not None
            tools = () if own.mask is None else (read_mask(own.mask),)
            name = f"{view}/{files.name}" if len(session.rig.names) > 1 else files.name
            camera = session.rig.view(view).camera
            image = read_image(own.image)
            yield Picture(group, name, image, camera, instrument, number % 2 == 0, files.readings, tools)


def found_in(
    picture: Picture, body: Body, settings: SegmentSettings | None = None, config: EstimateConfig | None = None
) -> SegmentedFrame:
    """Find a picture's mask and pose as `estimate` does; DvrkCmaesError if no instrument is found."""
    data = FrameData.of(np.zeros(picture.image.shape[:2], np.bool_), picture.camera, image=picture.image)
    method = FrameMethod("classic", config or EstimateConfig(), segment=settings)
    return segment_and_estimate(data, FrameFiles(picture.name, None, picture.joints), body, method)


GROUPS: Final[Mapping[str, Callable[[Path], Iterator[Picture]]]] = {
    "jhu": _jhu,
    "endovis17": _endovis17,
    "ucsd19": _ucsd19,
    "lincoln": _lincoln,
    "easy": lambda frames: _real(frames, "easy"),
    "medium": lambda frames: _real(frames, "medium"),
}


def read_pictures(frames: Path, groups: Sequence[str], predicted: Path | None = None) -> Iterator[Picture]:
    """Yield the pictures of some groups; ``predicted`` has the silhouettes of the bench's pictures, by eye."""
    for group in groups:
        yield from _bench(frames, predicted) if group == "bench" else GROUPS[group](frames)
