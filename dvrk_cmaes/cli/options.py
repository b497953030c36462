"""Options that several commands share, and what they stand for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from dvrk_cmaes.errors import InputError

if TYPE_CHECKING:
    from dvrk_cmaes.camera.files import CameraFile
    from dvrk_cmaes.config import EstimateConfig
    from dvrk_cmaes.frames.session_folder import Session
    from dvrk_cmaes.segment.with_instrument import Hints, SegmentSettings
    from dvrk_cmaes.silhouette import Body

FRAME = Group.create_ordered("Frame")
CAMERA = Group.create_ordered("Camera")
INSTRUMENT = Group.create_ordered("Instrument")
METHOD = Group.create_ordered("Method")
SEGMENT = Group.create_ordered("Mask, found in the image")
OUTPUT = Group.create_ordered("Output")

Flag = Annotated[bool, Parameter(negative=())]
SessionOption = Annotated[Path | None, Parameter(name="--session", group=METHOD)]


@Parameter(name="*", group=CAMERA)
@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """The camera, from a file of any kind that calibration tools write.

    Parameters
    ----------
    camera
        Intrinsics and lens distortion: ROS camera_info, OpenCV YAML or XML, kalibr camchain, or plain YAML. A session
        folder's own camera.yaml unless given.
    rectified
        The images are rectified: use the camera's projection matrix, without distortion.
    side
        Which camera of a stereo pair.
    """

    camera: Path | None = None
    rectified: Flag = False
    side: Literal["left", "right"] = "left"

    def read(self, size: Callable[[], tuple[int, int]] | None = None) -> CameraFile:
        """Read the file; ``size`` finds that of the images, px, for a file that does not state it."""
        from dvrk_cmaes.camera.files import read_camera_file

        if self.camera is None:
            raise InputError("--camera: expected a camera file, got none")
        return read_camera_file(self.camera, rectified=self.rectified, side=self.side, size=size)

    def read_session(self, folder: Path, *, known: Iterable[str], joints: Sequence[Path] = ()) -> Session:
        """Read a session folder, seen by this camera; ``known`` and ``joints`` as in `read_session` of the package."""
        from dvrk_cmaes.frames.session_folder import read_session

        return read_session(
            folder, camera=self.camera, rectified=self.rectified, side=self.side, known=known, joints=joints
        )


@Parameter(name="*", group=INSTRUMENT)
@dataclass(frozen=True, kw_only=True)
class InstrumentOptions:
    """Which instrument is sought, and the arm that carries it.

    Parameters
    ----------
    instrument
        A bundled instrument (lnd, a Large Needle Driver), or the path of a URDF.
    package_path
        NAME=DIR: where the ROS package NAME of package:// paths lies. May be given several times.
    root_link
        The URDF's link whose pose is sought, with the shaft on it or below it; roll_link unless given.
    shaft_radius
        Radius of the shaft in metres, instead of the one measured on its mesh.
    tool
        The dVRK's description of the tool (JSON): its joint limits instead of the URDF's, and where it lies along the
        shaft.
    arm
        The arm's kinematics, for camera_from_base.
    """

    instrument: str = "lnd"
    package_path: Annotated[tuple[str, ...], Parameter(negative=(), show_default=False)] = ()
    root_link: str | None = None
    shaft_radius: float | None = None
    tool: Path | None = None
    arm: Literal["classic", "si"] = "classic"

    def load(self) -> Body:
        """Load the instrument and prepare it for rendering."""
        from dvrk_cmaes.instrument import load_instrument
        from dvrk_cmaes.instrument.dvrk_description import read_tool
        from dvrk_cmaes.instrument.tool import with_tool
        from dvrk_cmaes.silhouette import Body

        tool = None if self.tool is None else read_tool(self.tool)
        loaded = load_instrument(
            self.instrument,
            package_paths=split_packages(self.package_path),
            root_link=self.root_link,
            shaft_radius=self.shaft_radius,
            keep_measured=True,
        )
        return Body.prepare(loaded if tool is None else with_tool(loaded, tool))


@Parameter(name="*", group=METHOD)
@dataclass(frozen=True, kw_only=True)
class MethodOptions:
    """How the pose is sought. A flag wins over the settings file, the file over the defaults.

    Parameters
    ----------
    search
        The global search: cmaes, crs2, esch, isres, direct-l.
    refine
        The local refinement: gauss-newton, coordinate-descent, bobyqa, sbplx.
    seed
        Seed of all random numbers; the same seed gives the same answer.
    threads
        How many threads to use; the answer does not depend on it.
    config
        A TOML file of settings, named as in a result's `config`.
    """

    search: str | None = None
    refine: str | None = None
    seed: int | None = None
    threads: int | None = None
    config: Path | None = None

    def resolve(self) -> EstimateConfig:
        """Defaults, overridden by the settings file, overridden by the flags; checked."""
        from dvrk_cmaes.config import EstimateConfig
        from dvrk_cmaes.io.toml_file import read_config
        from dvrk_cmaes.pose.config_check import check_config
        from dvrk_cmaes.pose.refine import METHODS as REFINEMENTS
        from dvrk_cmaes.pose.search import METHODS as SEARCHES

        settings = EstimateConfig()
        if self.config is not None:
            settings = read_config(self.config, settings)
            try:
                check_config(settings)
            except InputError as error:
                raise InputError(f"{self.config}: {str(error).removeprefix('config: ')}") from None
        if self.search is not None:
            _check_name("search", self.search, SEARCHES)
            settings = replace(settings, search=replace(settings.search, method=self.search))
        if self.refine is not None:
            _check_name("refine", self.refine, REFINEMENTS)
            settings = replace(settings, refine=replace(settings.refine, method=self.refine))
        if self.seed is not None:
            if self.seed < 0:
                raise InputError(f"--seed: expected a whole number of at least 0, got {self.seed}")
            settings = replace(settings, seed=self.seed)
        if self.threads is not None:
            if self.threads < 1:
                raise InputError(f"--threads: expected a whole number of at least 1, got {self.threads}")
            settings = replace(settings, threads=self.threads)
        return settings


DEFAULT_CAMERA = CameraOptions()


@Parameter(name="*", group=SEGMENT)
@dataclass(frozen=True, kw_only=True)
class SegmentOptions:
    """How a mask is found in an image.

    Parameters
    ----------
    model
        classic needs nothing but the image; sam2 is Segment Anything 2 (pip install "dvrk-cmaes[sam2]").
    weights
        Folder of the encoder and decoder of an exported checkpoint, for sam2.
    """

    model: Literal["classic", "sam2"] = "classic"
    weights: Path | None = None

    def resolve(self) -> SegmentSettings:
        """Check that model and weights belong together."""
        from dvrk_cmaes.segment.with_instrument import SegmentSettings

        if self.model == "sam2" and self.weights is None:
            raise InputError("--weights: --model sam2 needs the folder of an exported checkpoint, got none")
        if self.model == "classic" and self.weights is not None:
            raise InputError("--weights: --model classic has none; expected them only with --model sam2")
        return SegmentSettings(self.model, None if self.weights is None else self.weights.absolute())


@Parameter(name="*", group=SEGMENT)
@dataclass(frozen=True, kw_only=True)
class PromptOptions:
    """Where the instrument is in the image; all of it together, or nothing.

    Parameters
    ----------
    box
        A box around the instrument, x0,y0,x1,y1 in pixels.
    point
        A pixel u,v on the instrument. May be given several times.
    not_point
        A pixel u,v that is not on the instrument. May be given several times.
    """

    box: Annotated[str | None, Parameter(allow_leading_hyphen=True)] = None
    point: Annotated[tuple[str, ...], Parameter(negative=(), show_default=False, allow_leading_hyphen=True)] = ()
    not_point: Annotated[tuple[str, ...], Parameter(negative=(), show_default=False, allow_leading_hyphen=True)] = ()

    def resolve(self) -> Hints:
        """Parse the numbers."""
        from dvrk_cmaes.segment.with_instrument import Hints

        box = None
        if self.box is not None:
            try:
                left, top, right, bottom = (float(part) for part in self.box.split(","))
            except ValueError:
                raise InputError(f"--box: expected x0,y0,x1,y1 in pixels, got {self.box!r}") from None
            box = (left, top, right, bottom)
        points = tuple(parse_pixel("point", text) for text in self.point)
        return Hints(box, points, tuple(parse_pixel("not-point", text) for text in self.not_point))


DEFAULT_INSTRUMENT = InstrumentOptions()
DEFAULT_METHOD = MethodOptions()
DEFAULT_SEGMENT = SegmentOptions()
DEFAULT_PROMPTS = PromptOptions()


def _check_name(option: str, name: str, known: Iterable[str]) -> None:
    from dvrk_cmaes.errors import nearest_first

    if name not in known:
        raise InputError(f"--{option}: expected one of {', '.join(nearest_first(name, known))}, got {name!r}")


def split_packages(texts: Iterable[str]) -> dict[str, Path]:
    """Folders of ROS packages by name, from NAME=DIR each."""
    return dict(_package(text) for text in texts)


def _package(text: str) -> tuple[str, Path]:
    """Split NAME=DIR."""
    name, equals, folder = text.partition("=")
    if not (name and equals and folder):
        raise InputError(f"--package-path: expected NAME=DIR, got {text!r}")
    if not Path(folder).is_dir():
        raise InputError(f"--package-path: {name}: no such folder: {folder}")
    return name, Path(folder)


def parse_pixel(option: str, text: str) -> tuple[float, float]:
    """Parse ``u,v``, a pixel."""
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--{option}: expected a pixel u,v, got {text!r}") from None
    return u, v
