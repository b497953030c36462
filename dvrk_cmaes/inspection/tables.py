"""Inspection of tables and arrays: joint readings, jaw tips, marker detections, image times, published poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dvrk_cmaes.frames.keypoints import read_keypoints
from dvrk_cmaes.frames.markers import read_detections
from dvrk_cmaes.frames.published_poses import read_published_poses
from dvrk_cmaes.inspection.finding import Finding, Options, counted, unit_of
from dvrk_cmaes.io.files import read_bytes
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.npy import read_small_array
from dvrk_cmaes.joints.reading import TIME_TOLERANCE, read_joint_file
from dvrk_cmaes.joints.times import read_image_times

_LABEL_RULES = {
    "frame": "a frame's readings are found by its name",
    "number": "a frame's readings are found by the number that its name ends in",
    "message": "a frame's readings are found by the image's time",
}


def inspect_joints(path: Path, options: Options) -> Finding:
    """Describe a file of joint readings of any format; InputError if it is not valid."""
    file = read_joint_file(path, read_as=options.read_as)
    rows = [row.readings() for row in file.rows.values()]
    read_of = {name: [row[name] for row in rows if name in row] for name in file.joints}
    ranges = {name: (min(values), max(values)) for name, values in read_of.items() if values}
    lines = [f"{file.kind}: {counted(len(rows), 'row')}", *(_range_text(name, *pair) for name, pair in ranges.items())]
    if without_readings := [name for name in file.joints if name not in ranges]:
        lines.append(f"no reading of {', '.join(without_readings)}")
    notes = list(file.notes)
    times = [row.time for row in file.rows.values() if row.time is not None]
    span = (min(times), max(times)) if times else None
    if span is not None:
        lines.append(f"times from {span[0] / NANOSECONDS:.3f} to {span[1] / NANOSECONDS:.3f} s")
        notes.append(
            f"readings are interpolated to an image's time, from at most {TIME_TOLERANCE / NANOSECONDS:g} s away"
        )
    if len(rows) > 1:
        notes.append(_LABEL_RULES[file.labels])
    read: dict[str, Any] = {
        "form": file.kind,
        "rows": len(rows),
        "found_by": file.labels,
        "ranges": ranges,
        "time_ns": span,
    }
    if len(rows) == 1:
        read["readings"] = rows[0]
    return Finding("joint readings", tuple(lines), read, tuple(notes))


def inspect_keypoints(path: Path) -> Finding:
    """Describe a table of jaw tips; InputError if it is not valid."""
    tips = read_keypoints(path)
    line = f"both jaw tips of {counted(len(tips), 'frame')}: {listed(tips)}"
    read = {"frames": {name: pair.tolist() for name, pair in tips.items()}}
    return Finding("jaw tips", (line,), read, ("the two tips of a frame may be in either order",))


def inspect_detections(path: Path) -> Finding:
    """Describe a table of detected markers; InputError if it is not valid."""
    detections = read_detections(path)
    line = f"painted markers seen in {counted(len(detections), 'frame')}: {listed(detections)}"
    read = {"frames": {name: sorted(markers) for name, markers in detections.items()}}
    return Finding("marker detections", (line,), read)


def inspect_tracker_array(path: Path) -> Finding:
    """Describe a tracker's array of a pose or of joints, distinguished by the file's name."""
    expected = "a tracker's start (a NumPy array of 6 or 4 numbers)"
    numbers = read_small_array(
        str(path), read_bytes(path, expected=expected, largest=10_000), expected=expected
    ).tolist()
    pose = path.stem.endswith("_ctr")
    meaning = "axis-angle rad, translation m" if pose else "wrist_pitch, wrist_yaw, jaw_2, jaw_1 rad"
    text = f"{meaning}: {' '.join(f'{number:.5g}' for number in numbers)}"
    kind = "tracker's pose" if pose else "tracker's joints"
    return Finding(kind, (text,), {"values": numbers}, ("told by its name",))


def inspect_image_times(path: Path) -> Finding:
    """Describe a table of image times; InputError if it is not valid."""
    times = read_image_times(path)
    line = f"the times of {counted(len(times), 'image')}: {listed(times)}"
    return Finding("image times", (line,), {"time_ns": times})


def inspect_published_poses(path: Path) -> Finding:
    """Describe a table of published poses; InputError if it is not valid."""
    poses = read_published_poses(path)
    line = f"poses (axis-angle and translation of camera_from_root) and joints of {counted(len(poses), 'frame')}"
    return Finding("published poses", (line,), {"frames": list(poses)})


def _range_text(name: str, low: float, high: float) -> str:
    """Format the range of a joint, in mm or degrees."""
    scale, unit = unit_of(name)
    low, high = scale * low, scale * high
    return f"{name} {low:.2f} {unit}" if low == high else f"{name} from {low:.2f} to {high:.2f} {unit}"
