"""``dvrk-cmaes estimate``: the pose of an instrument from one mask or one image."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    FRAME,
    NO_READINGS,
    OUTPUT,
    TWIN,
    CalibrationOptions,
    Flag,
    Four,
    FrameCameraOptions,
    MethodOptions,
    Pixel,
    ReadingOptions,
    SegmentOptions,
    UrdfOptions,
    joint_files,
    numbers,
    options,
)
from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line, answer, exit_code, note, table_lines, warn
from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from dvrk_cmaes.frames.frame import FrameFiles
    from dvrk_cmaes.joints.lag import Lag
    from dvrk_cmaes.joints.reading import FrameReadings
    from dvrk_cmaes.results.result import Result


@options(group=FRAME)
class FrameOptions:
    """The files of a frame, and where the instrument is in them.

    Parameters
    ----------
    mask
        Mask of the instrument: PNG of 8 bits or 1, or JPEG, pixels above 127 are instrument. By default the mask is
        found in the image. [--mask or --image required]
    joints
        Joint readings: a joints.csv, a dump of measured_js or jaw/measured_js, or another file of readings; or values
        such as wrist_pitch=-0.68,wrist_yaw=-0.36,jaw=1.34 (rad; insertion in m); or none, as by default. May be given
        several times.
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
    only
        Arm, such as PSM1, whose joints are read of files with those of several.
    reading
        How files of readings are read.
    """

    mask: Path | None = None
    joints: Annotated[tuple[str, ...], Parameter(negative=(), show_default=False)] = ()
    frame: str | None = None
    time: str | None = None
    image: Path | None = None
    ignore: Path | None = None
    mask_right: Path | None = None
    image_right: Path | None = None
    ignore_right: Path | None = None
    keypoints: Annotated[Four | None, numbers("four numbers u1,v1,u2,v2 in pixels", 4)] = None
    label: str | None = None
    pick: Pixel = None
    only: str | None = None
    reading: ReadingOptions = ReadingOptions()

    def check(self, *, segmented: bool, uncalibrated: bool) -> None:
        """Raise an InputError for files that are missing or do not fit together.

        ``segmented``: nothing says how images are; ``uncalibrated``: there is no camera file.
        """
        missing = []
        if self.named is None:
            missing.append("--mask: expected a mask, or an image to find it in (--image FILE), got neither")
        if uncalibrated:
            from dvrk_cmaes.frames.session_folder import UNCALIBRATED

            missing.append(f"--camera: expected a camera file, got none; {UNCALIBRATED}")
        if missing:
            raise InputError("; ".join(missing))
        if self.mask is None and not (self.label is None and self.pick is None):
            raise InputError("--label, --pick: expected a mask with them (--mask FILE), got none")
        if self.mask is not None and not segmented:
            options = "--box, --point, --not-point, --model, --weights"
            raise InputError(f"{options}: expected no mask with them, got --mask too")

    @property
    def named(self) -> Path | None:
        """The file that names the frame: the mask, or the image without one."""
        return self.image if self.mask is None else self.mask

    def files(self, camera: FrameCameraOptions) -> FrameFiles:
        """Return the files of the frame, without readings; InputError for a value that is not valid."""
        import numpy as np

        from dvrk_cmaes.frames.frame import FrameFiles
        from dvrk_cmaes.frames.label import parse_label
        from dvrk_cmaes.frames.picture_fit import parse_crop
        from dvrk_cmaes.joints.interpolation import NANOSECONDS
        from dvrk_cmaes.joints.times import parse_time, time_in_name

        assert self.named is not None
        tips = None if self.keypoints is None else np.reshape(self.keypoints, (2, 2))
        label = None if self.label is None else parse_label("--label", self.label)
        name = self.named.stem if self.frame is None else self.frame
        found = time_in_name(self.named.stem) if self.time is None else parse_time("--time", self.time)
        moment = None if found is None else found / NANOSECONDS
        crop = None if camera.crop is None else parse_crop("--crop", camera.crop)
        files = FrameFiles(name, self.mask, {}, self.image, self.ignore, tips, label, self.pick, moment, crop=crop)
        if self.mask_right is None and self.image_right is None:
            return files
        right = FrameFiles(name, self.mask_right, {}, self.image_right, self.ignore_right, None, label, crop=crop)
        return replace(files, others={"right": right})

    def readings(self, known: Sequence[str], lag: Lag | None) -> FrameReadings:
        """Read the readings of the frame; empty without ``--joints``, or with none."""
        from dvrk_cmaes.joints.reading import is_written_out, read_frame_joints
        from dvrk_cmaes.joints.times import parse_time

        if self.joints in ((), (NO_READINGS,)) or self.named is None:
            return {}, (), None
        read_as = replace(self.reading.read_as(self.only), known=tuple(known))
        texts = [text for text in self.joints if is_written_out(text)]
        files = joint_files([Path(text) for text in self.joints if text not in texts], read_as.arm) or ()
        moment = None if self.time is None else parse_time("--time", self.time)
        return read_frame_joints(
            [*texts, *files], frame=self.frame, image=self.named.stem, time=moment, lag=lag, read_as=read_as
        )


def estimate(
    *,
    given: FrameOptions = FrameOptions(),
    segment: SegmentOptions = SegmentOptions(),
    calibrated: CalibrationOptions = CalibrationOptions(),
    camera: FrameCameraOptions = FrameCameraOptions(),
    instrument: UrdfOptions = UrdfOptions(),
    method: MethodOptions = MethodOptions(),
    out: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Estimate the pose of an instrument in the camera, and its joint angles, from one mask or one image.

    Candidates in LookAt space are compared with the mask by silhouettes that Embree casts rays for, CMA-ES (or one of
    NLopt's algorithms, --search) searches from the best, and the modes found are refined on the outline.

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
    given
        The frame.
    segment
        Segmentation of the image.
    calibrated
        A calibration that is used: start from the pose that it predicts, and search globally only if that pose does not
        explain the mask. If it has a lag between images and readings, files of readings are read at the frame's time
        less the lag; readings given as values are not changed.
    camera
        The camera, of which a file is needed.
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
    given.check(segmented=segment == SegmentOptions(), uncalibrated=camera.camera is None)
    from dvrk_cmaes.estimation.one_tool import FrameMethod
    from dvrk_cmaes.frames.frame import read_frame
    from dvrk_cmaes.frames.images import looks_like_mask
    from dvrk_cmaes.results.folder import mask_path, overlay_path, result_path
    from dvrk_cmaes.runs.frame import run_frame

    settings = method.resolve()
    files = given.files(camera)
    if out is not None:
        from dvrk_cmaes.io.output import check_files

        kinds = (result_path, overlay_path, *(() if given.mask is not None else (mask_path,)))
        check_files(out, "estimate", [path(Path(), files.name).as_posix() for path in kinds])
    camera_file = camera.read(files)
    data = read_frame(files, camera_file.rig)
    if given.mask is None and data.image is not None and looks_like_mask(data.image):
        warn(f"{given.image}: it looks like a mask: give it by --mask")
    body = instrument.load()
    known = calibrated.read(body, instrument.arm)
    if not given.joints:
        note(f"no --joints, as with --joints none: {TWIN}")
    lag = None if known is None else known.applied_lag
    readings, notes, _ = given.readings(body.instrument.joint_names, lag)
    files = replace(files, readings=readings, prompts=segment.hints())
    data = replace(data, files=files, notes=(*camera_file.notes, *notes, *data.notes))
    solved_as = FrameMethod(instrument.kinematics, settings, known, segment.resolve())
    result, written = run_frame(data, body, solved_as, out)
    for text in dict.fromkeys((*result.remarks, *result.warnings)):
        warn(text)
    answer(result.to_dict(), _lines(result, written), json=json)
    return exit_code([result.status])


def _lines(result: Result, written: Sequence[Path]) -> Iterator[Line]:
    """Yield the lines of a result: accuracy, status, reasons, fit, pose, joints, alternatives and the files written."""
    from dvrk_cmaes.report.tables import result_lines, result_tables

    accuracy, *fit = result_lines(result)
    yield Line(f"{result.frame}: {accuracy}, {result.status}", STATUS_STYLES[result.status])
    yield from (Line(f"  {text}", "yellow") for text in result.reasons)
    unused = (text for text in result.unused if result.readings or not text.startswith("reading of"))
    yield from (Line(f"  {text}") for text in (*fit, *(f"not used: {text}" for text in unused)))
    for table in result_tables(result):
        yield from table_lines(table)
    yield Line(f"{result.seconds:.2f} s, {result.evaluations} silhouettes")
    yield from (Line(f"written: {path}") for path in written)
