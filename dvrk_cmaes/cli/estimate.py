"""``dvrk-cmaes estimate``: the pose of an instrument from one mask or one image."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dvrk_cmaes.cli.describe import describe
from dvrk_cmaes.cli.options import (
    DEFAULT_INSTRUMENT,
    DEFAULT_METHOD,
    DEFAULT_PROMPTS,
    DEFAULT_READING,
    DEFAULT_SEGMENT,
    FRAME,
    NO_READINGS,
    OUTPUT,
    DoubtfulSessionOption,
    Flag,
    FrameCameraOptions,
    InstrumentOptions,
    MethodOptions,
    PromptOptions,
    ReadingOptions,
    SegmentOptions,
    SessionOption,
    joint_files,
    parse_pixel,
)
from dvrk_cmaes.cli.terminal import answer, exit_code, warn
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.joints.reading import FrameReadings, ReadAs

_Hyphens = Parameter(allow_leading_hyphen=True)


def estimate(
    *,
    mask: Annotated[Path | None, Parameter(group=FRAME)] = None,
    joints: Annotated[tuple[str, ...], Parameter(group=FRAME, negative=())],
    frame: Annotated[str | None, Parameter(group=FRAME)] = None,
    time: Annotated[str | None, Parameter(group=FRAME)] = None,
    image: Annotated[Path | None, Parameter(group=FRAME)] = None,
    ignore: Annotated[Path | None, Parameter(group=FRAME)] = None,
    mask_right: Annotated[Path | None, Parameter(group=FRAME)] = None,
    image_right: Annotated[Path | None, Parameter(group=FRAME)] = None,
    ignore_right: Annotated[Path | None, Parameter(group=FRAME)] = None,
    keypoints: Annotated[str | None, Parameter(group=FRAME), _Hyphens] = None,
    label: Annotated[str | None, Parameter(group=FRAME)] = None,
    pick: Annotated[str | None, Parameter(group=FRAME), _Hyphens] = None,
    model: SegmentOptions = DEFAULT_SEGMENT,
    prompts: PromptOptions = DEFAULT_PROMPTS,
    calibration: SessionOption = None,
    doubtful_session: DoubtfulSessionOption = False,
    only: Annotated[str | None, Parameter(group=FRAME)] = None,
    reading: ReadingOptions = DEFAULT_READING,
    camera: FrameCameraOptions,
    instrument: InstrumentOptions = DEFAULT_INSTRUMENT,
    method: MethodOptions = DEFAULT_METHOD,
    out: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Estimate the pose of an instrument in the camera, and its joint angles, from one mask or one image.

    Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 doubtful (with reasons).

    Example:

    ```
    dvrk-cmaes estimate --mask 26.png --camera camera.yaml --joints joints.csv
    ```

    Without a mask, it is found in the image:

    ```
    dvrk-cmaes estimate --image 26.jpg --camera camera.yaml --joints joints.csv
    ```

    Parameters
    ----------
    mask
        Mask of the instrument: PNG of 8 bits or 1, or JPEG, pixels above 127 are instrument. By default the mask is
        found in the image. [--mask or --image required]
    joints
        Joint readings: a joints.csv, a dump of measured_js or jaw/measured_js, or another file of readings; or values
        such as wrist_pitch=-0.68,wrist_yaw=-0.36,jaw=1.34 (rad; insertion in m); or none, if there are no readings. May
        be given several times.
    frame
        Name of the frame: its row in joints.csv, and its name in the output. By default the file name of the mask, or
        of the image without a mask.
    time
        Time of the image in seconds, for files of readings with times: the readings are interpolated to it between rows
        at most 0.05 s away.
    image
        Image: background of the overlay and, without --mask, the image in which the mask is found. [--mask or
        --image required]
    ignore
        Mask of the pixels that are not used, such as tissue or another tool before the instrument: 8-bit PNG or JPEG,
        pixels above 127 are ignored.
    mask_right
        Mask of the right eye of a stereo endoscope. --camera then has both eyes, or the left one beside --camera-right.
        The pose is in the left camera.
    image_right
        Image of the right eye, as --image.
    ignore_right
        Mask of the pixels of the right eye that are not used, as --ignore.
    keypoints
        Pixels of the two jaw tips, u1,v1,u2,v2, in either order.
    label
        Part of a mask of labels that is the instrument: a value (the index, in an image with a palette), several such
        as 10,20,30, a colour such as '#00ff00', or any, for all values but 0.
    pick
        Pixel u,v on the instrument: use only the connected region of the mask, or of the label, at this pixel.
    model
        Segmentation of the image.
    prompts
        Prompts for the segmentation.
    calibration
        A session.json written by `calibrate`: start from the pose that it predicts, and search globally only if that
        pose does not explain the mask. If it has a lag between images and readings, files of readings are read at the
        frame's time less the lag; readings given as values are not changed.
    doubtful_session
        Use the session.json of --session even if it predicts frames badly that it has not seen.
    only
        Arm, such as PSM1, whose joints are read of files with those of several.
    reading
        How files of readings are read.
    camera
        The camera.
    instrument
        The instrument.
    method
        The method.
    out
        Folder for frames/FRAME.json, overlays/FRAME.jpg and, if the mask was found in the image, masks/FRAME.png. By
        default no files are written.
    json
        Print only the result, as JSON, on stdout.
    """
    named = image if mask is None else mask
    if named is None:
        raise InputError("--mask: expected a mask, or an image to find it in (--image FILE), got neither")
    if mask is None and not (label is None and pick is None):
        raise InputError("--label, --pick: expected a mask with them (--mask FILE), got none")
    if mask is not None and (prompts, model) != (DEFAULT_PROMPTS, DEFAULT_SEGMENT):
        raise InputError("--box, --point, --not-point, --model, --weights: expected no mask with them, got --mask too")
    from dvrk_cmaes.cli.session_tools import read_calibration_of
    from dvrk_cmaes.estimation.one_tool import FrameMethod
    from dvrk_cmaes.frames.frame import FrameFiles
    from dvrk_cmaes.frames.keypoints import parse_keypoints
    from dvrk_cmaes.frames.label import parse_label
    from dvrk_cmaes.results.paths import mask_path, overlay_path, result_path
    from dvrk_cmaes.runs.frame import read_any_frame, run_frame
    from dvrk_cmaes.segment.segmentation import hints_within

    settings = method.resolve()
    tips = None if keypoints is None else parse_keypoints(keypoints)
    wanted = None if label is None else parse_label("--label", label)
    picked = None if pick is None else parse_pixel("pick", pick)
    name, moment = named.stem if frame is None else frame, _moment(time, named.stem)
    files = FrameFiles(name, mask, {}, image, ignore, tips, wanted, picked, moment, crop=camera.fit.crop)
    if out is not None:
        from dvrk_cmaes.io.output import check_files

        kinds = (result_path, overlay_path, *(() if mask is not None else (mask_path,)))
        check_files(out, "estimate", [path(Path(), name).as_posix() for path in kinds])
    if mask_right is None and image_right is None:
        camera_file = camera.read(files)
    else:
        other = FrameFiles(files.name, mask_right, {}, image_right, ignore_right, None, wanted, crop=files.crop)
        files = replace(files, others={"right": other})
        camera_file = camera.read_rig(files)
    data = read_any_frame(files, camera_file.rig)
    body = instrument.load()
    known = read_calibration_of(calibration, body, instrument.arm, doubtful=doubtful_session)
    lag = None if known is None else known.applied_lag
    read = _readings(joints, frame, named.stem, time, body.instrument.joint_names, lag, reading.read_as(only))
    files = replace(files, readings=read.readings)
    data = replace(data, notes=(*camera_file.notes, *read.notes, *data.notes))
    shown = hints_within(prompts.resolve(), files.crop)
    solved_as = FrameMethod(instrument.kinematics, settings, known, model.resolve(), shown)
    result, written = run_frame(files, data, body, solved_as, out)
    for text in dict.fromkeys((*result.remarks, *result.warnings)):
        warn(text)
    answer(result.to_dict(), describe(result, written), json=json)
    return exit_code([result.status])


def _moment(time: str | None, image: str) -> float | None:
    """Return the time of the image, s: as given, or at the end of its name; None if neither is known."""
    from dvrk_cmaes.joints.interpolation import NANOSECONDS
    from dvrk_cmaes.joints.times import parse_time, time_in_name

    found = time_in_name(image) if time is None else parse_time("--time", time)
    return None if found is None else found / NANOSECONDS


def _readings(
    joints: Sequence[str],
    frame: str | None,
    image: str,
    time: str | None,
    known: Sequence[str],
    lag: Lag | None,
    read_as: ReadAs,
) -> FrameReadings:
    """Read the readings of a frame; empty if ``--joints none`` is given."""
    from dvrk_cmaes.joints.reading import FrameReadings, read_frame_joints
    from dvrk_cmaes.joints.times import parse_time

    if tuple(joints) == (NO_READINGS,):
        return FrameReadings()
    from dvrk_cmaes.joints.reading import is_written_out

    texts = [text for text in joints if is_written_out(text)]
    files = joint_files([Path(text) for text in joints if text not in texts], read_as.arm) or ()
    moment = None if time is None else parse_time("--time", time)
    return read_frame_joints(
        [*texts, *files], frame=frame, image=image, time=moment, known=known, lag=lag, read_as=read_as
    )
