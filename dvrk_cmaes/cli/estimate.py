"""``dvrk-cmaes estimate``: one mask, or one image, to one pose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dvrk_cmaes.cli.describe import describe
from dvrk_cmaes.cli.options import (
    DEFAULT_CAMERA,
    DEFAULT_INSTRUMENT,
    DEFAULT_METHOD,
    DEFAULT_PROMPTS,
    DEFAULT_SEGMENT,
    FRAME,
    OUTPUT,
    CameraOptions,
    Flag,
    InstrumentOptions,
    MethodOptions,
    PromptOptions,
    SegmentOptions,
    SessionOption,
    parse_pixel,
)
from dvrk_cmaes.cli.terminal import show, warn
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dvrk_cmaes.joints.reading import FrameReadings

EXIT_CODES = {"ok": 0, "failed": 1, "doubtful": 3}
NO_READINGS = "none"

_Hyphens = Parameter(allow_leading_hyphen=True)


def estimate(
    *,
    mask: Annotated[Path | None, Parameter(group=FRAME)] = None,
    joints: Annotated[tuple[str, ...], Parameter(group=FRAME, negative=())],
    frame: Annotated[str | None, Parameter(group=FRAME)] = None,
    time: Annotated[str | None, Parameter(group=FRAME)] = None,
    image: Annotated[Path | None, Parameter(group=FRAME)] = None,
    ignore: Annotated[Path | None, Parameter(group=FRAME)] = None,
    keypoints: Annotated[str | None, Parameter(group=FRAME), _Hyphens] = None,
    label: Annotated[int | None, Parameter(group=FRAME)] = None,
    pick: Annotated[str | None, Parameter(group=FRAME), _Hyphens] = None,
    model: SegmentOptions = DEFAULT_SEGMENT,
    prompts: PromptOptions = DEFAULT_PROMPTS,
    calibration: SessionOption = None,
    camera: CameraOptions = DEFAULT_CAMERA,
    instrument: InstrumentOptions = DEFAULT_INSTRUMENT,
    method: MethodOptions = DEFAULT_METHOD,
    out: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Estimate the pose of an instrument in the camera, and its true joint angles, from one mask or one image.

    Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 doubtful (with reasons).

    Example:

    `dvrk-cmaes estimate --mask masks/0026.png --camera camera.yaml --joints joints.csv --image images/0026.png --out x`

    Without a mask, it is found in the image:

    `dvrk-cmaes estimate --image images/0026.png --camera camera.yaml --joints joints.csv --out x`

    Parameters
    ----------
    mask
        The instrument's mask: 8-bit PNG or JPEG, above 127 is instrument. Unless given, it is found in the image.
    joints
        Readings: a joints.csv, a dump of measured_js or jaw/measured_js, or another file of readings; or
        wrist_pitch=-0.68,wrist_yaw=-0.36,jaw=1.34 (rad; insertion in m); or none. May be given several times.
    frame
        The frame's row in joints.csv and its name in the output; the mask's name unless given.
    time
        The image's time in seconds, for readings by time: they are interpolated, from at most 0.05 s away.
    image
        The image, to draw the overlay on, and to find the mask in unless that is given.
    ignore
        Pixels that count neither way (an occluder, another tool): 8-bit, above 127.
    keypoints
        The jaw tips in either order, u1,v1,u2,v2 in pixels.
    label
        The mask is one of labels: the instrument is where it has this value.
    pick
        Of several things in the mask, the one at the pixel u,v.
    model
        How a mask is found in the image.
    prompts
        Where the instrument is in the image, to find its mask.
    calibration
        A session.json that `calibrate` made: start from what it expects, and search only if that does not explain the
        mask.
    camera
        Which camera.
    instrument
        Which instrument.
    method
        How to search.
    out
        Folder to write frames/FRAME.json and overlays/FRAME.jpg to, and masks/FRAME.png if it was found.
    json
        Print the result as JSON, and nothing else, on stdout.
    """
    if label is not None and pick is not None:
        raise InputError("--label, --pick: expected one of the two, got both")
    if label is not None and not 0 <= label <= 255:
        raise InputError(f"--label: expected a value of an 8-bit mask, 0 to 255, got {label}")
    named = image if mask is None else mask
    if named is None:
        raise InputError("--mask: expected a mask, or an image to find it in (--image FILE), got neither")
    if mask is None and not (label is None and pick is None):
        raise InputError("--label, --pick: expected a mask with them (--mask FILE), got none")
    if mask is not None and (prompts, model) != (DEFAULT_PROMPTS, DEFAULT_SEGMENT):
        raise InputError("--box, --point, --not-point, --model, --weights: expected no mask with them, got --mask too")
    from dvrk_cmaes.calibration.document import read_calibration
    from dvrk_cmaes.frames.frame import FrameFiles, frame_size, read_frame
    from dvrk_cmaes.frames.keypoints import parse_keypoints
    from dvrk_cmaes.io.atomic import json_text
    from dvrk_cmaes.runs.frame import run_frame

    settings = method.resolve()
    tips = None if keypoints is None else parse_keypoints(keypoints)
    picked = None if pick is None else parse_pixel("pick", pick)
    files = FrameFiles(named.stem if frame is None else frame, mask, {}, image, ignore, tips, label, picked)
    lens = camera.read(lambda: frame_size(files))
    data = None if mask is None else read_frame(files, lens.camera)
    body = instrument.load()
    found = _readings(joints, frame, named.stem, time, body.instrument.joint_names)
    files = replace(files, readings=found.readings)
    if data is None:
        from dvrk_cmaes.segment.with_instrument import Segmenter

        data = read_frame(files, lens.camera, Segmenter(body, settings, model.resolve(), prompts.resolve()))
    data = replace(data, notes=(*lens.notes, *found.notes, *data.notes))
    known = None if calibration is None else read_calibration(calibration)
    run = run_frame(files, data, body, arm=instrument.arm, config=settings, out=out, session=known)
    for text in run.result.warnings:
        warn(text)
    if json:
        print(json_text(run.result.to_dict()), end="")
    else:
        show(describe(run.result, run.written))
    return EXIT_CODES[run.result.status]


def _readings(
    joints: Sequence[str], frame: str | None, image: str, time: str | None, known: Sequence[str]
) -> FrameReadings:
    """Read a frame's readings, of which there may be none."""
    from dvrk_cmaes.joints.reading import FrameReadings, read_frame_joints
    from dvrk_cmaes.joints.times import parse_time

    if tuple(joints) == (NO_READINGS,):
        return FrameReadings()
    moment = None if time is None else parse_time("--time", time)
    return read_frame_joints(joints, frame=frame, image=image, time=moment, known=known)
