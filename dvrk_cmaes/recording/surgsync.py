"""Reader of clips in the raw layout of SurgSync, the dVRK's recorder of synchronised images and kinematics.

Frame N of a clip has the files::

    image/left/N.png, image/right/N.png
    kinematic/ARM/N.json     readings of the arm (measured_js) and of its jaw
    time_syn/N.json          times of the image and of the readings

``camera_calibration`` has left.yaml and right.yaml, and in stereo_calib_params.json the pose between them, which is
used where right.yaml states none. ``hand_eye_calibration`` has the arms' registrations, which are kept for comparison.
The recorder takes the readings that are nearest in time to each image; here they are interpolated between those of
neighbouring frames to the image's time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.camera.files import Side, read_document
from dvrk_cmaes.camera.stereo import has_pose, pose_of_storage
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.short_text import listed, shown
from dvrk_cmaes.joints.gaps import within
from dvrk_cmaes.joints.interpolation import NANOSECONDS, TimedReadings, weighted_mean
from dvrk_cmaes.joints.names import ECM_JOINTS
from dvrk_cmaes.recording.camera import read_camera_bytes, with_pose
from dvrk_cmaes.recording.messages import stored_image
from dvrk_cmaes.recording.recording import Asked, ImageFile, RecordedImage, Recording
from dvrk_cmaes.recording.surgsync_frame import FrameTimes, read_ecm, read_positions, read_times

ECM: Final = "ECM"
"""Name of the arm that holds the endoscope."""

_CAMERAS: Final = "camera_calibration"
_STEREO: Final = "stereo_calib_params.json"
REGISTRATIONS: Final = "hand_eye_calibration"
"""Folder of the arms' registrations, in a clip and in a session."""
_LARGEST: Final = 400_000_000  # bytes of an image
_LARGEST_REGISTRATION: Final = 1_000_000  # bytes
_FARTHEST: Final = NANOSECONDS // 20  # of the readings of a frame from its image
_WIDEST_GAP: Final = NANOSECONDS // 4  # between readings that are interpolated
_IMAGES: Final = (".png", ".jpg")


def is_surgsync(path: Path) -> bool:
    """Whether a folder has the raw layout."""
    return (path / "image").is_dir() and (path / "kinematic").is_dir()


@contextmanager
def open_surgsync(path: Path, asked: Asked) -> Iterator[Recording]:
    """Open a clip; times and readings are read at once, images during iteration.

    Parameters
    ----------
    path
        The clip's folder.
    asked
        What is read; an arm is required of a clip of several patient-side arms.

    Raises
    ------
    InputError
        A file is missing or not valid, or several arms were recorded and none was chosen.
    """
    side, images = asked.side, _images(path, asked.side)
    camera_bytes, source = camera_of_clip(path / _CAMERAS, asked)
    arms = [folder.name for folder in (path / "kinematic").iterdir() if folder.is_dir()]
    chosen = None if asked.joints is not None else chosen_arm(path, arms, asked.arm, "clip")
    times = {number: read_times(path / "time_syn" / f"{number}.json", side, chosen) for number in images}
    notes = [f"images: image/{side}", f"camera: {source}", "times: those of the images in time_syn"]
    readings, said = asked.given_readings()
    notes += said
    if chosen is not None:
        readings = _readings(path / "kinematic" / chosen, times)
        notes += [f"{' '.join(series.joints)}: kinematic/{chosen}" for series in readings]
        if (folder := path / "kinematic" / ECM).is_dir() and chosen != ECM:
            try:
                readings = (*readings, _ecm_readings(folder, path / "time_syn", side, times))
                notes.append(f"{' '.join(ECM_JOINTS)}: kinematic/{ECM}")
            except InputError as error:
                notes.append(f"the endoscope's arm is not read: {error}")
    kept, of_kept = registrations(path / REGISTRATIONS)
    recorded = (
        RecordedImage(number, times[number].image, lambda file=file: _load(file))  # type: ignore[misc]
        for number, file in images.items()
    )
    yield Recording(path, recorded, len(images), camera_bytes, readings, (*notes, *of_kept), kept)


def registrations(folder: Path) -> tuple[dict[str, bytes], list[str]]:
    """Read the registrations of a clip's arms, and say that they are kept."""
    kept = {
        f"{REGISTRATIONS}/{file.name}": read_bytes(file, expected="a registration", largest=_LARGEST_REGISTRATION)
        for file in sorted(folder.glob("*.json"))
    }
    return kept, [f"registrations, kept: {listed(kept, 8)}"] if kept else []


def camera_of_clip(folder: Path, asked: Asked) -> tuple[bytes, str]:
    """Read the given camera file or that of an eye in a clip's folder, and say what was read.

    To that of a right eye without a pose, the one between the eyes is added.
    """
    lens, stereo = asked.camera or folder / f"{asked.side}.yaml", folder / _STEREO
    data = read_camera_bytes(lens)
    if asked.camera is not None or asked.side == "left" or not stereo.is_file():
        return data, str(lens)
    right = read_document(lens)
    if has_pose(str(lens), right):
        return data, str(lens)
    pose, notes = pose_of_storage(str(stereo), read_document(stereo), rectified=False)
    return with_pose(right, pose), "; ".join([f"{lens}, pose between the eyes: {stereo}", *notes])


def _images(path: Path, side: Side) -> dict[int, Path]:
    """Find the images of a camera by frame number, in order; InputError if there are none."""
    folder = path / "image" / side
    files = [file for file in folder.iterdir() if file.suffix.lower() in _IMAGES] if folder.is_dir() else []
    images = {int(file.stem): file for file in files if file.stem.isascii() and file.stem.isdigit()}
    if not images:
        raise InputError(f"{folder}: expected images N.png, got none")
    return dict(sorted(images.items()))


def _load(file: Path) -> ImageFile:
    """Read an image; its file is copied unchanged."""
    return stored_image(read_bytes(file, expected="an image (PNG or JPEG)", largest=_LARGEST), str(file))


def chosen_arm(path: Path, arms: Sequence[str], arm: str | None, what: str) -> str:
    """Return the requested arm, or the only patient-side one of a clip or episode."""
    if arm is not None and arm not in arms:
        raise InputError(f"{path}: --arm: expected one of {listed(sorted(arms)) or 'no arms'}, got {shown(arm)}")
    patient_side = sorted(name for name in arms if name.startswith("PSM"))
    if arm is None and len(patient_side) != 1:
        there = listed(patient_side) or "none"
        raise InputError(f"{path}: --arm: expected the name of the arm to import, for this {what} has {there}")
    return arm or patient_side[0]


def _readings(folder: Path, times: Mapping[int, FrameTimes]) -> tuple[TimedReadings, ...]:
    """Read the readings of all frames: a series of the arm's joints and one of the jaw, at the times of the images."""
    rows = _rows(folder, times, read_positions)
    first = next(iter(rows.values()))
    arm, jaw = tuple(name for name in first if name != "jaw"), tuple(name for name in first if name == "jaw")
    images = {number: frame.image for number, frame in times.items()}
    taken = {
        number: (frame.arm or frame.image, frame.jaw or frame.arm or frame.image) for number, frame in times.items()
    }
    return tuple(
        at_images(str(folder), joints, rows, images, {number: moments[part] for number, moments in taken.items()})
        for part, joints in enumerate((arm, jaw))
        if joints
    )


def _rows(
    folder: Path, numbers: Iterable[int], read: Callable[[Path], dict[str, float]]
) -> dict[int, dict[str, float]]:
    """Read the files of some frames; InputError if there are none."""
    rows = {number: read(file) for number in numbers if (file := folder / f"{number}.json").is_file()}
    if not rows:
        raise InputError(f"{folder}: expected readings N.json of the images' numbers, got none")
    return rows


def _ecm_readings(folder: Path, syn: Path, side: Side, times: Mapping[int, FrameTimes]) -> TimedReadings:
    """Read the readings of the endoscope's arm of all frames, at the times of the images."""
    rows = _rows(folder, times, read_ecm)
    images = {number: frame.image for number, frame in times.items()}
    taken = {number: read_times(syn / f"{number}.json", side, ECM).arm or images[number] for number in rows}
    return at_images(str(folder), ECM_JOINTS, rows, images, taken)


def at_images(
    source: str,
    joints: tuple[str, ...],
    rows: Mapping[int, Mapping[str, float]],
    images: Mapping[int, int],
    taken: Mapping[int, int],
) -> TimedReadings:
    """Interpolate readings that were ``taken`` near the images' times, ns, to these; where not possible, keep them.

    Readings that are farther from their image than the recorder allows are omitted.
    """
    values = {
        number: [row[name] for name in joints]
        for number, row in rows.items()
        if set(joints) <= set(row) and abs(taken[number] - images[number]) <= _FARTHEST
    }
    if not values:
        away = min(abs(taken[number] - images[number]) for number in rows) / NANOSECONDS
        raise InputError(
            f"{source}: {', '.join(joints)}: expected readings within {_FARTHEST / NANOSECONDS:g} s of the images, "
            f"got none; the nearest is {away:.6g} s away"
        )
    series = TimedReadings.of(source, joints, [taken[number] for number in values], list(values.values()))
    moments = [images[number] for number in values]
    at, gaps = np.array(moments, dtype=np.int64), within(_WIDEST_GAP)
    known, interpolated = series.known(at, gaps), series.at(at, gaps, weighted_mean).tolist()
    at_images = [new if there else own for new, own, there in zip(interpolated, values.values(), known, strict=True)]
    return TimedReadings.of(source, joints, moments, at_images)
