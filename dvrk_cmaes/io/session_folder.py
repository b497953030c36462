"""A session folder: frames of one camera with their masks, readings, and what else there is.

camera.yaml, joints.csv, masks/<frame>.png
optional: images/<frame>.png|jpg, ignore/<frame>.png, keypoints.csv, golden.json
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.camera_file import Side, read_camera_file
from dvrk_cmaes.io.frame_files import FrameFiles
from dvrk_cmaes.io.golden_file import SessionTruth, read_golden
from dvrk_cmaes.io.joints import read_joint_table
from dvrk_cmaes.io.keypoints import read_keypoints

_MASKS = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, eq=False)
class Session:
    """A session: its camera, its frames in the order of their names, and the truth where it is known."""

    folder: Path
    camera: Camera
    frames: tuple[FrameFiles, ...]
    truth: SessionTruth


def read_session(
    folder: str | Path,
    *,
    camera: Path | None = None,
    rectified: bool = False,
    side: Side = "left",
    known: Iterable[str] = (),
) -> Session:
    """Find the frames of a session folder and read all of it but the pictures.

    A frame is a file in ``masks`` or in ``images``; one without a row in joints.csv has no readings.

    Parameters
    ----------
    folder
        The session.
    camera
        The camera file, if it is not the session's own camera.yaml.
    rectified, side
        Whether the images are rectified, and which camera of a stereo pair, as in ``read_camera_file``.
    known
        Names of the instrument's own joints, as in ``read_joints``.

    Raises
    ------
    InputError
        A file that is missing or wrong, naming it; no frames; a name twice.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{folder}: no such folder; expected a session with camera.yaml, joints.csv and masks")
    masks = _pictures(root / "masks")
    images, ignore = _pictures(root / "images"), _pictures(root / "ignore")
    if not masks and not images:
        raise InputError(f"{root / 'masks'}: expected masks (PNG or JPEG) of the frames, got none")
    lens = read_camera_file(camera or root / "camera.yaml", rectified=rectified, side=side)
    readings = read_joint_table(root / "joints.csv", known=known)
    tips = read_keypoints(root / "keypoints.csv") if (root / "keypoints.csv").exists() else {}
    frames = tuple(
        FrameFiles(
            name=name,
            mask=masks.get(name),
            readings=readings.get(name, {}),
            image=images.get(name),
            ignore=ignore.get(name),
            keypoints=tips.get(name),
            notes=lens.notes,
        )
        for name in sorted({*masks, *images})
    )
    golden = root / "golden.json"
    return Session(
        folder=root,
        camera=lens.camera,
        frames=frames,
        truth=read_golden(golden) if golden.exists() else SessionTruth(),
    )


def _pictures(folder: Path) -> Mapping[str, Path]:
    """PNG and JPEG files of a folder by the frame that they are named after; none where there is no folder."""
    if not folder.is_dir():
        return {}
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in _MASKS or path.name.startswith("."):
            continue
        if path.stem in found:
            raise InputError(f"{path}: expected one file for frame {path.stem}, got {found[path.stem].name} too")
        found[path.stem] = path
    return found
