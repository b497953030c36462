"""Options shared by several commands, and their conversion to settings and data of the package."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, dataclass_transform

from cyclopts import Group, Parameter, Token

from dvrk_cmaes.cli.terminal import warn
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import is_number, shown

if TYPE_CHECKING:
    from dvrk_cmaes.calibration.document import SessionCalibration
    from dvrk_cmaes.camera.files import CameraFile
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.frames.frame import FrameFiles
    from dvrk_cmaes.frames.session_toml import ToolEntry
    from dvrk_cmaes.joints.rows import JointFile, ReadAs
    from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings
    from dvrk_cmaes.silhouette import Body

T = TypeVar("T")

FOLDER = Group.create_ordered("Folder")
WORKERS = Group.create_ordered("Workers")
FRAME = Group.create_ordered("Frame")
CAMERA = Group.create_ordered("Camera")
READINGS = Group.create_ordered("Readings")
INSTRUMENT = Group.create_ordered("Instrument")
METHOD = Group.create_ordered("Method")
SEGMENT = Group.create_ordered("Segmentation")
OUTPUT = Group.create_ordered("Output")

LARGEST_SEED = 2**32 - 1
MOST_PROCESSES = 1000
MOST_SKIPPED = 1_000_000  # of --every
AUTO = "auto"  # of --lag
NO_READINGS = "none"  # of --joints
TWIN = "poses may be those of a mirror twin, and are doubtful; --joints FILE gives readings"
"""What follows where there are no readings."""
_OF_MESHES = 4.3e-3, 4.45e-3
"""Radii between which that of the meshes of the dVRK's description is, 4.37 mm, m."""
LATEST = 1e11  # s, of times since any clock's start


def check_range(option: str, value: float | None, least: float, most: float, what: str = "a whole number") -> None:
    """Raise an InputError for the value of an option that is given and not from ``least`` to ``most``."""
    if value is not None and not least <= value <= most:
        limit = f"at most {most:.10g}" if value > most else f"at least {least:.10g}"
        raise InputError(f"{option}: expected {what} of {limit}, got {shown(value)}")


def whole(least: float = -math.inf, most: float = math.inf, **more: Any) -> Parameter:
    """Return how an option takes a whole number in a range; InputError for others, such as 1.5, which are not rounded.

    ``more`` are further fields of `Parameter`.
    """

    def converted(_: Any, tokens: Sequence[Token]) -> int:
        try:
            value = int(tokens[0].value)
        except ValueError:
            raise InputError(f"{tokens[0].keyword}: expected a whole number, got {shown(tokens[0].value)}") from None
        check_range(tokens[0].keyword or "", value, least, most)
        return value

    return Parameter(converter=converted, **more)


def numbers(expected: str, count: int, *, several: bool = False) -> Parameter:
    """Return how an option takes finite numbers with commas between them; InputError for others, or not so many.

    One that may be given ``several`` times has a tuple of such tuples.
    """

    def converted(_: Any, tokens: Sequence[Token]) -> Any:
        found = []
        for token in tokens:
            values = [float(part) for part in token.value.split(",") if is_number(part) and math.isfinite(float(part))]
            if len(values) != count or token.value.count(",") != count - 1:
                raise InputError(f"{token.keyword}: expected {expected}, got {token.value!r}")
            found.append(tuple(values))
        return tuple(found) if several else found[0]

    return Parameter(converter=converted, negative=(), show_default=False, allow_leading_hyphen=True)


if TYPE_CHECKING:
    Two = tuple[float, float]
    Four = tuple[float, float, float, float]
else:
    Two = Four = str  # as they are given
LayoutOption = Literal["mono", "side-by-side", "top-bottom"] | None
EveryNth = Annotated[int, whole(1, MOST_SKIPPED)]
SeedOption = Annotated[int, whole(0, LARGEST_SEED)]
Processes = Annotated[int | None, whole(1, MOST_PROCESSES)]
"""Number of processes, or of threads."""
Flag = Annotated[bool, Parameter(negative=())]
Pixel = Annotated[Two | None, numbers("a pixel u,v", 2)]
Pixels = Annotated[tuple[Two, ...], numbers("a pixel u,v", 2, several=True)]
ConfigOption = Annotated[Path | None, Parameter(name="--config", group=METHOD)]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def options(**shown: Any) -> Callable[[type[T]], type[T]]:
    """Return a decorator for a class whose fields are options of a command, ``shown`` as `Parameter` says."""
    return lambda kind: Parameter(name="*", **shown)(dataclass(frozen=True, kw_only=True)(kind))


@options(group=CAMERA)
class CameraOptions:
    """Options of the camera's file.

    Parameters
    ----------
    camera
        File of the intrinsics and the lens distortion: ROS camera_info, OpenCV YAML or XML, kalibr camchain, or plain
        YAML. Of a session folder, its own camera.yaml by default; a single frame needs one.
    rectified
        The images are rectified: use the projection matrix of the camera file, and no distortion.
    side
        Camera to use if the file describes a stereo pair and one view is used.
    """

    camera: Path | None = None
    rectified: Flag = False
    side: Literal["left", "right"] = "left"


@options(group=CAMERA)
class FrameCameraOptions(CameraOptions):
    """Options of the camera of a single frame.

    Parameters
    ----------
    camera_right
        File of the right camera, where both eyes are used and the files are two.
    crop
        x,y,w,h: the part of masks and images that is the camera's picture, in pixels of the files. Of a camera file for
        the whole images, the principal point is moved. Results are in pixels of the part.
    stretch
        The images were resized unevenly: scale the camera to their size, though that has another aspect.
    """

    camera_right: Path | None = None
    crop: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    stretch: Flag = False

    def read(self, frame: FrameFiles) -> CameraFile:
        """Read the camera of a frame, or those of both eyes; the frame has the size where no file states it."""
        from dvrk_cmaes.camera.files import read_camera_file
        from dvrk_cmaes.camera.rig_files import read_rig
        from dvrk_cmaes.frames.picture_fit import fitted

        assert self.camera is not None
        read_as: dict[str, Any] = {"rectified": self.rectified, "size": lambda: frame.size}
        if frame.others:
            lens = read_rig(self.camera, self.camera_right, **read_as)
        else:
            lens = read_camera_file(self.camera, side=self.side, **read_as)
        return fitted(lens, frame, stretch=self.stretch)


@options(group=READINGS)
class ReadingOptions:
    """Options of files of joint readings.

    Parameters
    ----------
    columns
        Names of the columns of a CSV of readings, in place of its header, such as
        time,yaw,pitch,insertion,roll,wrist_pitch,wrist_yaw; - for a column that is not read. Without frame or time, the
        rows are counted from 0.
    frame_offset
        Number of the row that frame 0 has: frame N has the row OFFSET + STEP N. By default, rows are found by the names
        of the frames.
    frame_step
        Number of rows from a frame to the next one, with --frame-offset.
    """

    columns: str | None = None
    frame_offset: Annotated[int | None, whole(allow_leading_hyphen=True)] = None
    frame_step: EveryNth = 1

    def read_as(self, arm: str | None = None) -> ReadAs:
        """Return how files are read; ``arm`` is that of session.toml."""
        from dvrk_cmaes.joints.rows import ReadAs

        offset = 0 if self.frame_offset is None and self.frame_step > 1 else self.frame_offset
        return ReadAs(arm or None, column_names(self.columns), offset, self.frame_step)


def column_names(text: str | None) -> tuple[str, ...]:
    """Return the names of columns that --columns gives; none without it."""
    return () if text is None else tuple(name.strip() for name in text.split(","))


def joint_files(given: Sequence[Path], arm: str | None = None) -> Sequence[Path | JointFile] | None:
    """Return the files that --joints names, or None for none; the readings of an arm in a ROS recording are read."""
    if not given or tuple(given) == (Path(NO_READINGS),):
        return None if given else ()
    from dvrk_cmaes.recording.topics import is_bag

    return [_bag_joints(path, arm) if path.exists() and is_bag(path) else path for path in given]


def _bag_joints(path: Path, arm: str | None) -> JointFile:
    """Return the readings of an arm in a ROS recording, whose reader is imported only for one."""
    from dvrk_cmaes.recording.bag import read_bag_joints

    return read_bag_joints(path, arm)


@options(group=INSTRUMENT)
class InstrumentOptions:
    """Options of the instrument and of the arm that carries it.

    Parameters
    ----------
    instrument
        Bundled instrument by name (lnd, prograsp, maryland, mega_needle_driver, cautery_hook) or number (400093), or
        path of a URDF. By default that of the session's session.toml, or else lnd.
    arm
        Arm whose kinematics are used to compute camera_from_base: classic or si. By default that of session.toml, or
        else classic.
    description
        Checkout of jhu-dvrk/dvrk_model: --instrument may then be a number, such as 400093, of a URDF in it.
    """

    instrument: str | None = None
    arm: Literal["classic", "si"] | None = None
    description: Path | None = None

    @property
    def described(self) -> Mapping[str, Path]:
        """The ROS package of the description, by its name."""
        return {} if self.description is None else {"dvrk_model": self.description}

    def load_for(self, tool: ToolEntry) -> Body:
        """Load the instrument that is given, or else that of a tool as session.toml names it."""
        named, own = self.instrument, tool.instrument
        if named is not None:
            if own is not None and named != own and Path(named).resolve() != Path(own).resolve():
                warn(f"{tool.arm}: session.toml names {own}, but --instrument {named} is used")
            tool = replace(tool, instrument=named, packages={}, root_link=None, tool=None)
        return load_tool(replace(tool, packages={**tool.packages, **self.described}))


@options(group=INSTRUMENT)
class UrdfOptions(InstrumentOptions):
    """Options of the instrument and of the arm that carries it.

    Parameters
    ----------
    instrument
        Bundled instrument by name (lnd, prograsp, maryland, mega_needle_driver, cautery_hook) or number (400093), or
        path of a URDF. By default lnd.
    arm
        Arm whose kinematics are used to compute camera_from_base: classic, as by default, or si.
    package_path
        NAME=DIR: folder of the ROS package NAME, for package://NAME/... paths in the URDF. Other packages are searched
        for in the URDF's folder and its parents. May be given several times.
    root_link
        Link of the URDF whose pose is estimated; the shaft must be on it or below it. roll_link by default.
    tool
        Description of the tool in the dVRK's format (JSON): its joint limits replace those of the URDF, and its roll
        offset (length along the shaft) replaces that of the tools 400xxx.
    """

    package_path: Annotated[tuple[str, ...], Parameter(negative=(), show_default=False)] = ()
    root_link: str | None = None
    tool: Path | None = None

    @property
    def kinematics(self) -> Literal["classic", "si"]:
        """The arm's kinematics."""
        return self.arm or "classic"

    def as_tool(self, arm: str = "") -> ToolEntry:
        """Return the tool of these options that an arm holds, as session.toml would name it."""
        from dvrk_cmaes.frames.session_toml import ToolEntry

        packages = {**split_packages(self.package_path), **self.described}
        return ToolEntry(arm, self.kinematics, self.instrument or "lnd", packages, self.root_link, self.tool)

    def load(self) -> Body:
        """Load the instrument, and prepare it for rendering."""
        return load_tool(self.as_tool())


def load_tool(tool: ToolEntry) -> Body:
    """Load the instrument of a tool, from the cache of instruments if it is there, and prepare it for rendering."""
    from dvrk_cmaes.instrument import load_instrument
    from dvrk_cmaes.instrument.dvrk_description import read_tool
    from dvrk_cmaes.instrument.tool import with_tool
    from dvrk_cmaes.silhouette.prepare import prepare

    described = None if tool.tool is None else read_tool(tool.tool)
    loaded = load_instrument(
        tool.instrument or "lnd", package_paths=tool.packages, root_link=tool.root_link, use_cache=True
    )
    if (radius := loaded.shaft_radius) is not None and _OF_MESHES[0] < radius < _OF_MESHES[1]:
        warn(
            f"{loaded.name}: a shaft of {1e3 * radius:.2f} mm radius, as the dVRK's description has: real ones measure "
            "4.07 mm, and depth comes out 7 % too large (see `dvrk-cmaes help instruments`)"
        )
    return prepare(loaded if described is None else with_tool(loaded, described))


@options(group=METHOD)
class MethodOptions:
    """Options of the method. An option overrides the settings file, and the settings file overrides the defaults.

    Parameters
    ----------
    search
        Method of the global search: cmaes (default), direct-l, bobyqa or sbplx. The others are there to compare
        with: they find as many modes in more than twice the time.
    preset
        card: Gauss-Newton takes its derivatives by central differences of outlines drawn anew, not in closed form:
        nearly the same poses, in more than twice the time.
    seed
        Seed of all random numbers, a whole number of at least 0; 0 by default. The same input and the same seed give
        the same result.
    threads
        Number of threads (of each worker process in `batch`); 1 by default. The result does not depend on it.
    config
        Settings file (TOML) with the keys of a result's `config`; `dvrk-cmaes help settings` lists them. The other
        options override it.
    """

    search: Literal["cmaes", "direct-l", "bobyqa", "sbplx"] | None = None
    preset: Literal["card"] | None = None
    seed: Annotated[int | None, whole(0, LARGEST_SEED)] = None
    threads: Processes = None
    config: Path | None = None

    def resolve(self) -> EstimateConfig:
        """Return the settings: the defaults, overridden by the settings file, overridden by the options.

        Raises
        ------
        InputError
            A value is not valid; the message names the option or the settings file.
        """
        from dvrk_cmaes.config import EstimateConfig
        from dvrk_cmaes.io.toml_file import read_config
        from dvrk_cmaes.pose.config_check import check_config

        settings = EstimateConfig()
        if self.config is not None:
            settings = read_config(self.config, settings)
            try:
                check_config(settings)
            except InputError as error:
                raise InputError(f"{self.config}: {str(error).removeprefix('config: ')}") from None
        if self.search is not None:
            settings = replace(settings, search=replace(settings.search, method=self.search))
        if self.preset == "card":
            settings = replace(settings, refine=replace(settings.refine, derivatives="differences"))
        given = {name: value for name in ("seed", "threads") if (value := getattr(self, name)) is not None}
        return replace(settings, **given)


@options()
class SessionOptions:
    """Options of the session that a command works on.

    Parameters
    ----------
    only
        Arm of a session.toml with several tools: this one only; by default all of them, with the results of each in
        OUT/ARM. May be given several times.
    camera
        Camera to use instead of the session's own.
    instrument
        The instrument, and the arm that carries it.
    config
        Settings file (TOML) with the keys of a result's `config`; `dvrk-cmaes help settings` lists them.
    """

    only: Annotated[tuple[str, ...], Parameter(group=FOLDER, negative=(), show_default=False)] = ()
    camera: CameraOptions = CameraOptions()
    instrument: InstrumentOptions = InstrumentOptions()
    config: ConfigOption = None

    def settings(self) -> EstimateConfig:
        """Return the settings of the settings file; InputError if one is not valid."""
        return MethodOptions(config=self.config).resolve()


@options(group=SEGMENT)
class PromptOptions:
    """Optional prompts, which state where the instrument is in the image.

    Parameters
    ----------
    box
        Box around the instrument, x0,y0,x1,y1 in pixels.
    point
        Pixel u,v on the instrument. May be given several times.
    not_point
        Pixel u,v that is not on the instrument. May be given several times.
    """

    box: Annotated[Four | None, numbers("x0,y0,x1,y1 in pixels", 4)] = None
    point: Pixels = ()
    not_point: Pixels = ()

    def hints(self) -> Hints:
        """Return the prompts."""
        from dvrk_cmaes.segment.segmentation import Hints

        return Hints(self.box, self.point, self.not_point)


@options(group=SEGMENT)
class SegmentOptions(PromptOptions):
    """Options of the segmentation of images without a mask, with prompts.

    Parameters
    ----------
    model
        Segmentation model: classic uses colour and shape and needs no weights; sam2 is Segment Anything 2, by the
        library onnxruntime.
    weights
        Folder with the encoder and the decoder of an exported checkpoint; required for sam2.
    """

    model: Literal["classic", "sam2"] = "classic"
    weights: Path | None = None

    def resolve(self) -> SegmentSettings:
        """Return the settings; InputError if sam2 has no weights, or classic has any."""
        from dvrk_cmaes.segment.segmentation import SegmentSettings

        if self.model == "sam2" and self.weights is None:
            raise InputError("--weights: --model sam2 needs the folder of an exported checkpoint, got none")
        if self.model == "classic" and self.weights is not None:
            raise InputError("--weights: --model classic has none; expected them only with --model sam2")
        return SegmentSettings(self.model, None if self.weights is None else self.weights.absolute())


@options(group=METHOD)
class CalibrationOptions:
    """Options of a calibration that is used.

    Parameters
    ----------
    calibration
        A session.json written by `calibrate` or `track`, or the folder that has one for each of several arms.
    doubtful_session
        Use the session.json of --session even if it predicts frames badly that it has not seen.
    """

    calibration: Annotated[Path | None, Parameter(name="--session")] = None
    doubtful_session: Annotated[Flag, Parameter(name="--doubtful-session")] = False

    def read(self, body: Body, kinematics: Literal["classic", "si"] | None, arm: str = "") -> SessionCalibration | None:
        """Read the calibration of an arm: a session.json, or that of the folder which `calibrate` wrote; None without.

        ``arm`` is one of a session with several: its own is in the folder's subfolder of that name. ``body`` is the
        instrument that it is used with, ``kinematics`` those of its arm, if they were given.

        Raises
        ------
        InputError
            There is no session.json, it is not valid, of another instrument or arm, or it predicts frames badly.
        """
        from dvrk_cmaes.calibration.document import check_made_for, read_calibration
        from dvrk_cmaes.calibration.session_doubts import bad_predictions
        from dvrk_cmaes.results.folder import SESSION

        path = self.calibration
        if path is None:
            return None
        if path.is_dir():
            own = path / arm / SESSION
            path = own if own.exists() else path / SESSION
        calibration = read_calibration(path)
        check_made_for(f"{path}", calibration, body.instrument.name, kinematics)
        bad = bad_predictions(calibration)
        if bad and not self.doubtful_session:
            raise InputError(f"{path}: {bad}; --doubtful-session uses it all the same")
        for doubt in calibration.doubts:
            warn(f"{path}: {doubt}; all results are doubtful")
        return calibration

    def check_for(self, arms: Collection[str]) -> None:
        """Raise an InputError unless there is a folder of calibrations where there are several arms."""
        if len(arms) > 1 and self.calibration is not None and not self.calibration.is_dir():
            expected = "expected the folder that calibrate wrote, with a session.json for each arm"
            raise InputError(f"--session: {expected}, got {self.calibration}")


def split_packages(texts: Iterable[str]) -> dict[str, Path]:
    """Return the folders of ROS packages by name, from texts NAME=DIR; InputError for another form, or no folder."""
    found = {}
    for text in texts:
        name, _, folder = text.partition("=")
        if not (name and folder):
            raise InputError(f"--package-path: expected NAME=DIR, got {text!r}")
        if not Path(folder).is_dir():
            raise InputError(f"--package-path: {name}: no such folder: {folder}")
        found[name] = Path(folder)
    return found
