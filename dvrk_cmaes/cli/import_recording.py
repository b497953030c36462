"""``dvrk-cmaes import``: conversion of a ROS recording, or of a video and its readings, to a session folder."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from dvrk_cmaes.cli.options import (
    AUTO,
    LATEST,
    OUTPUT,
    EveryNth,
    Flag,
    LayoutOption,
    check_range,
    column_names,
    joint_files,
    options,
    whole,
)
from dvrk_cmaes.cli.terminal import Line, answer, tracked, warn
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import counted, shown

if TYPE_CHECKING:
    from dvrk_cmaes.geometry import Float64
    from dvrk_cmaes.instrument.arm import Arm
    from dvrk_cmaes.instrument.dvrk_description import Tool
    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.recording.pose_table import PosePoint
    from dvrk_cmaes.recording.recording import Asked
    from dvrk_cmaes.recording.write_session import ImportSummary

SELECTION = Group.create_ordered("Selection")
TOPICS = Group.create_ordered("ROS recording")
VIDEO = Group.create_ordered("Video")
POSES = Group.create_ordered("Cartesian poses")
FOLDER = Group.create_ordered("Stereo endoscope")
MOST_EPISODES = 1_000_000


@options(group=TOPICS)
class TopicOptions:
    """Topics of a ROS recording, found by type and name by default; if several are suitable, one must be given.

    Parameters
    ----------
    image_topic
        Topic of the images (sensor_msgs/Image or CompressedImage), or none to import readings alone. By default the
        only one of these types.
    image_topic_right
        Topic of the images of the right eye, with --side both. By default the only one with right in its name.
    camera_topic
        Topic of the camera (sensor_msgs/CameraInfo). By default camera_info in the namespace of the images, or the only
        one of this type.
    joints_topic
        Topic of the arm's joints (sensor_msgs/JointState), or none to import no readings. By default the only
        measured_js or state_joint_current of an arm.
    jaw_topic
        Topic of the jaw (sensor_msgs/JointState), or none to import no readings of the jaw. By default jaw/measured_js
        or state_jaw_current in the namespace of the arm's topic.
    recorded_times
        Use the times at which the messages were recorded instead of those in their headers.
    rectified
        The images are rectified: session.toml says so, and the other commands use the projection matrix.
    """

    image_topic: str | None = None
    image_topic_right: str | None = None
    camera_topic: str | None = None
    joints_topic: str | None = None
    jaw_topic: str | None = None
    recorded_times: Flag = False
    rectified: Flag = False


@options(group=POSES)
class PoseOptions:
    """Meaning of a table of Cartesian poses given as --joints, whose joints are found by inverse kinematics.

    Parameters
    ----------
    pose_of
        Take --joints as a table of poses (time, x, y, z, qx, qy, qz, qw, and jaw if known), or the poses of a LeRobot
        data set as those, of this point: tip, the dVRK's tip frame (measured_cp), or wrist-yaw, the origin of the wrist
        yaw axis with the tip's axes.
    pose_base
        Frame that the poses are given in: local, the arm's base (local/measured_cp), or a file with the pose of the
        arm's base in that frame (measured_cp). Required with --pose-of.
    kinematics
        Kinematics of the arm: classic or si.
    tool
        dVRK tool description (JSON). By default the Large Needle Driver 400006.
    """

    pose_of: Literal["tip", "wrist-yaw"] | None = None
    pose_base: str | None = None
    kinematics: Literal["classic", "si"] = "classic"
    tool: Path | None = None

    def meaning(self) -> tuple[PosePoint, Float64, Arm, Tool | None] | None:
        """Return what poses mean, as of `read_pose_table`; None without --pose-of."""
        if self.pose_of is None:
            if self != PoseOptions():
                others = "--pose-base, --kinematics and --tool"
                raise InputError(f"--pose-of: expected tip or wrist-yaw with {others}, got none")
            return None
        if self.pose_base is None:
            raise InputError(
                "--pose-base: expected local for poses in the arm's base (local/measured_cp), or a file with the pose "
                "of the base in their frame (measured_cp), got none"
            )
        import numpy as np

        from dvrk_cmaes.export.cartesian_pose import read_cartesian_pose
        from dvrk_cmaes.instrument.dvrk_description import read_tool

        base = np.eye(4) if self.pose_base == "local" else read_cartesian_pose(Path(self.pose_base))
        return self.pose_of, base, self.kinematics, None if self.tool is None else read_tool(self.tool)


@options(group=VIDEO)
class RecordingFiles:
    """A recording, its parts that are read, and what goes with it.

    Parameters
    ----------
    side
        Eye of a stereo endoscope whose images are imported, left by default, or both. Of a ROS recording, it is a word
        in the name of the images' topic.
    arm
        Arm, such as PSM1, whose readings are imported, where a recording has those of several. Of a ROS recording, it
        may be given several times: then session.toml names all of them, each with its own readings.
    episode
        Number of the episode of a LeRobot data set.
    camera
        Camera file, or none, for `calibrate` to find the camera. Required for a video; for other recordings it replaces
        their own.
    joints
        File of readings with times, e.g. CSV with a column time (s). Required for a video; for other recordings it
        replaces their own.
    columns
        Names of the columns of --joints, in place of its header, such as
        time,yaw,pitch,insertion,roll,wrist_pitch,wrist_yaw; - for a column that is not read.
    video_start
        Time of the first image of a video, or of stereo videos, on the clock of the readings, in seconds.
    layout
        Where the eyes are in the pictures of a stereo video; --side chooses one or both. By
        default found from the size of the camera's images.
    crop
        x,y,w,h: the part of the pictures of a video that is the camera's, in pixels.
    masks
        Masks of the images: a folder of them, named as the rows of --joints or by the numbers of the images, a video of
        masks, or a COCO file.
    """

    side: Annotated[Literal["left", "right", "both"] | None, Parameter(group=FOLDER)] = None
    arm: Annotated[tuple[str, ...], Parameter(group=FOLDER, negative=(), show_default=False)] = ()
    episode: Annotated[int, whole(0, MOST_EPISODES, group=FOLDER)] = 0
    camera: Path | None = None
    joints: Path | None = None
    columns: str | None = None
    video_start: float = 0.0
    layout: LayoutOption = None
    crop: str | None = None
    masks: Path | None = None

    def asked(self, topics: TopicOptions, poses: PoseOptions) -> Asked:
        """Return what is read of a recording; ``poses`` is what those mean that are read."""
        from dvrk_cmaes.frames.picture_fit import parse_crop
        from dvrk_cmaes.recording.pose_table import read_pose_table
        from dvrk_cmaes.recording.recording import Asked

        if self.columns is not None and poses.pose_of is not None:
            raise InputError("--columns: expected --joints of readings with it, got poses (--pose-of)")
        posed, arm = poses.meaning(), self.arm[0] if len(self.arm) == 1 else None
        tables = () if posed or self.joints is None else joint_files([self.joints], arm) or ()
        return Asked(
            side=None if self.side == "both" else self.side,
            both=self.side == "both",
            arms=self.arm,
            camera=self.camera,
            joints=read_pose_table(self.joints, *posed) if posed and self.joints else next(iter(tables), None),
            columns=column_names(self.columns),
            posed=None if self.joints else posed,
            start=self.video_start,
            layout=self.layout,
            crop=None if self.crop is None else parse_crop("--crop", self.crop),
            episode=self.episode,
            **vars(topics),
        )


@options(group=SELECTION)
class SelectedImages:
    """Which images are read, and at which times their readings.

    Parameters
    ----------
    every
        N: import every Nth image of those between --start and --end.
    start
        Start of the imported part, in seconds after the first image.
    end
        End of the imported part, in seconds after the first image.
    tolerance
        Largest distance in time, in seconds, between an image and the readings before and after it; an image without
        readings this near gets none.
    lag
        Lag of the images behind the readings, in seconds, such as 0.13: each image gets the readings of that much
        earlier. With auto, or none given, it is the lag found by --session; without that none is taken out.
    calibration
        A session.json written by `calibrate` from a session imported from this recording, or from another one made in
        the same way: its lag is taken out.
    """

    every: EveryNth = 1
    start: float = 0.0
    end: float = math.inf
    tolerance: float = 0.05
    lag: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    calibration: Annotated[Path | None, Parameter(name="--session")] = None

    def check(self) -> None:
        """Raise an InputError for values that are not valid."""
        if not 0 < self.tolerance < math.inf:
            raise InputError(f"--tolerance: expected a time in seconds above 0, got {self.tolerance:g}")
        if not (0 <= self.start < self.end):
            got = f"{self.start:g} and {self.end:g}"
            raise InputError(f"--start, --end: expected 0 <= start < end in seconds, got {got}")


def import_recording(
    recording: Path,
    /,
    *,
    selected: SelectedImages = SelectedImages(),
    files: RecordingFiles = RecordingFiles(),
    out: Annotated[Path, Parameter(group=OUTPUT)],
    topics: TopicOptions = TopicOptions(),
    poses: PoseOptions = PoseOptions(),
    overwrite: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Convert a ROS recording (no ROS needed), a video with joint readings or a SurgSync clip to a session folder.

    Readings are interpolated to the times of the images, and never extrapolated. The session folder has images, and
    those masks that --masks gives.

    Example:

    ```
    dvrk-cmaes import suturing.bag --out session --every 10
    ```

    ```
    dvrk-cmaes import a.mp4 --camera camera.yaml --joints joints.csv --out session
    ```

    ```
    dvrk-cmaes import online_data/2 --arm PSM1 --out session
    ```

    Parameters
    ----------
    recording
        ROS 1 .bag file, ROS 2 folder (or its .mcap or .db3 file), or any video that OpenCV reads. Or the folder of a
        clip in SurgSync's raw layout or of a packed episode (timestamp.parquet), a folder of SurgPose
        (regular/left_video.mp4, api_jp_data.yaml), a LeRobot data set (meta/info.json), one with the videos of a stereo
        endoscope (left.mp4 and right.mp4).
    selected
        Which images are read, and at which times their readings.
    files
        Which parts of the recording are read, and what goes with it.
    out
        Session folder to write; it must be new or empty unless --overwrite is given.
    topics
        The topics.
    poses
        The meaning of poses.
    overwrite
        Replace a session folder that this command wrote, unless a file in it was added or changed since.
    json
        Print only a summary, as JSON, on stdout.
    """
    selected.check()
    taken, said = _lag(selected.lag, selected.calibration)
    check_range("--video-start", files.video_start, -LATEST, LATEST, "seconds")
    from dvrk_cmaes.io.files import check_own_folder
    from dvrk_cmaes.recording.readers import open_recording
    from dvrk_cmaes.recording.write_session import write_session

    check_own_folder(recording)
    opened = open_recording(recording, files.asked(topics, poses))
    summary = write_session(
        replace(opened, images=iter(tracked(opened.images, "Importing", opened.total)), masks=files.masks),
        out,
        every=selected.every,
        start=selected.start,
        end=selected.end,
        tolerance=selected.tolerance,
        lag=taken,
        overwrite=overwrite,
    )
    for source in summary.readings:
        if source.without:
            total, within = source.frames + source.without, selected.tolerance
            warn(f"{source.source}: {source.without} of {total} frames have no readings within {within:g} s")
    for text in (*summary.warnings, *([said] if said else [])):
        warn(text)
    answer(summary.to_dict(), _lines(summary), json=json)
    return 0


def _lag(text: str | None, calibration: Path | None) -> tuple[Lag | None, str]:
    """Return the lag in seconds to take out of the readings, None for none, and a warning, which may be empty."""
    from dvrk_cmaes.calibration.document import read_calibration
    from dvrk_cmaes.joints.lag import Lag

    if text is not None and text != AUTO:
        given = Lag.parse("--lag", text)
        if given.seconds is None:
            raise InputError(f"--lag: expected a number of seconds such as 0.13, got {shown(text)}")
        return (given if given.seconds else None), ""
    if calibration is None:
        if text == AUTO:
            raise InputError("--lag: auto: expected --session FILE too, the session.json of a calibrated session")
        return None, ""
    found = read_calibration(calibration)
    if found.lag is None:
        why = next((text for text in found.undetermined if text.startswith("lag")), "lag: not determined")
        return None, f"{calibration}: {why}: none is taken out"
    if found.applied_lag is None:
        said = f"zero within its standard deviation ({found.lag.describe()}): none is taken out"
        return None, f"{calibration}: lag: {said}"
    if found.lag.seconds is None:
        raise InputError(f"{calibration}: lag: expected seconds, as of a session with times, got {found.lag.text}")
    return found.lag, ""


def _lines(summary: ImportSummary) -> Iterator[Line]:
    """Yield the lines of an import: images, notes, and distances in time of the readings used."""
    if summary.frames:
        sizes = f"{counted(summary.images, 'image')}, {summary.size[0]} x {summary.size[1]}"
        yield Line(f"{counted(summary.frames, 'frame')} of {sizes}", "bold")
    for note in summary.notes:
        yield Line(f"  {note}")
    for source in summary.readings:
        far = "" if source.farthest_s is None else f", from readings at most {1e3 * source.farthest_s:.1f} ms away"
        yield Line(f"  {source.source}: {source.frames} frames with readings, {source.without} without{far}")
    yield Line(f"written: {summary.session}")
