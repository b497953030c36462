"""A followed recording for the Rerun viewer: images, masks, the links' meshes, camera and joints on a timeline.

The program is that of rerun.io, of the extra ``viewer``. The space of the recording is the camera's: x right, y down, z
forward, metres; with a rig, it is the first camera's, whose entity is ``camera``, and a further view NAME has its
pictures in ``camera_NAME``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.errors import InputError, missing_library
from dvrk_cmaes.geometry import Float64, inverse
from dvrk_cmaes.instrument import Instrument
from dvrk_cmaes.io.output import not_written, whole_file
from dvrk_cmaes.results.tracked import TrackView

EXTENSION: Final = ".rrd"
_CAMERA: Final = "camera"
_QUALITY: Final = 85  # of the images' JPEG
_LONGEST_BATCH: Final = 60.0  # s of rows in a chunk; the viewer is slow with many small ones
_HALF: Final = 0.5  # px; the centre of the viewer's first pixel is at (0.5, 0.5), of ours at (0, 0)
_MASK: Final = (240, 228, 66, 90)  # RGBA
_OUTLINE: Final = (86, 180, 233)
_METAL: Final = (190, 190, 196)
_EYE: Final = (0.09, -0.08, -0.09)  # m in the camera, from where the view in space is looked at
_LOOKED_AT: Final = (0.0, 0.0, 0.08)
_LEVELS: Final = {"ok": "INFO", "doubtful": "WARN"}  # of a text; ERROR for other statuses


def check_rerun(option: str, path: Path) -> None:
    """Raise unless a recording for Rerun can be written to a path, which an option of the command line gave.

    Raises
    ------
    InputError
        The name has another extension.
    DvrkCmaesError
        rerun-sdk is not installed.
    """
    if path.suffix.lower() != EXTENSION:
        raise InputError(f"{option}: expected the name of a file that ends in {EXTENSION}, got {str(path)!r}")
    _library()


@contextmanager
def rerun_file(path: Path, cameras: Camera | Rig, instrument: Instrument, session: str) -> Iterator[RerunFile]:
    """Open a recording that is written under a temporary name and renamed when it is complete.

    Raises
    ------
    InputError
        It cannot be written there.
    DvrkCmaesError
        rerun-sdk is not installed.
    """
    rerun = _library()
    with whole_file(path, "a recording for Rerun") as temporary:
        rig = Rig.of(cameras)
        batches = rerun.ChunkBatcherConfig(flush_tick=_LONGEST_BATCH)
        stream = rerun.RecordingStream("dvrk_cmaes", recording_id=session, batcher_config=batches)
        try:
            stream.save(temporary, default_blueprint=_blueprint(rig))
        except RuntimeError as error:
            raise not_written(path, OSError(None, str(error)), "a recording for Rerun") from None
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        stream.reset_time()  # the library keeps the time of a recording of the same name by thread
        try:
            yield RerunFile(stream, rig, instrument)
        finally:
            stream.disconnect()


class RerunFile:
    """Logs the frames of a recording, in order, to a ``rerun.RecordingStream``."""

    def __init__(self, stream: Any, rig: Rig, instrument: Instrument) -> None:
        import trimesh

        self._rerun, self._stream, self._instrument = _library(), stream, instrument
        self._entities = _camera_entities(rig)
        self._status: str | None = None
        rr = self._rerun
        self._static("/", rr.ViewCoordinates.RDF)
        for entity, view in zip(self._entities, rig.views, strict=True):
            if entity != _CAMERA:
                self._static(entity, self._transform(inverse(view.view_from_camera)))
            size = [view.camera.width, view.camera.height]
            matrix = view.camera.matrix
            matrix[:2, 2] += _HALF
            self._static(entity, rr.Pinhole(image_from_camera=matrix, resolution=size, image_plane_distance=0.05))
        for link in instrument.links:
            normals = trimesh.Trimesh(link.vertices, link.faces, process=False).vertex_normals
            mesh = rr.Mesh3D(
                vertex_positions=link.vertices,
                triangle_indices=link.faces,
                vertex_normals=normals,
                albedo_factor=_METAL,
            )
            self._static(f"instrument/{_part(link.name)}", mesh)

    def add(self, number: int, row: Mapping[str, Any], read: Mapping[str, float], views: Sequence[TrackView]) -> None:
        """Log a frame.

        Parameters
        ----------
        number, row
            Index of the frame, from 0; its line of tracks.jsonl.
        read
            Readings by joint, rad, NaN where there is none.
        views
            What each view of the rig shows of it.
        """
        self._stream.set_time("frame", sequence=number)
        if row["time"] is not None:
            self._stream.set_time("time", duration=row["time"])
        for entity, view in zip(self._entities, views, strict=True):
            self._pictures(entity, view)
        self._pose(row)
        for name in self._instrument.joint_names:
            self._scalar(f"joints/{_part(name)}/found", np.degrees(row["joints"].get(name, np.nan)))
            self._scalar(f"joints/{_part(name)}/read", np.degrees(read.get(name, np.nan)))
        for name, value in (row.get("offsets") or {}).items():
            self._scalar(f"offsets/{_part(name)}", np.degrees(value))
        if row["std"] and row["std"].get("tip_mm") is not None:
            self._scalar("std/tips_mm", row["std"]["tip_mm"])
        self._say(row)

    def _pictures(self, entity: str, view: TrackView) -> None:
        """Log image, mask and outline below a camera's entity; those that are missing are cleared."""
        jpeg, png = None, None
        if view.image is not None:
            jpeg = cv2.imencode(".jpg", view.image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
        if view.mask is not None:
            red, green, blue, alpha = _MASK
            tint = np.where(view.mask[..., None], np.array([blue, green, red, alpha], np.uint8), np.uint8(0))
            png = cv2.imencode(".png", tint, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
        self._picture(f"{entity}/image", jpeg, "image/jpeg", 0)
        self._picture(f"{entity}/mask", png, "image/png", 1)
        strips: list[NDArray[np.int32]] = []
        if view.silhouette is not None:
            contours, _ = cv2.findContours(view.silhouette.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
            strips = [np.concatenate([each[:, 0], each[:1, 0]]).astype(np.int32) for each in contours]
        placed = [strip + _HALF for strip in strips]
        self._log(f"{entity}/outline", self._rerun.LineStrips2D(placed, colors=_OUTLINE, draw_order=2))

    def _picture(self, entity: str, data: bytes | None, media_type: str, order: int) -> None:
        """Log an encoded picture, or clear the one before."""
        rr = self._rerun
        if data is None:
            self._log(entity, rr.Clear(recursive=False))
        else:
            self._log(entity, rr.EncodedImage(contents=data, media_type=media_type, draw_order=order))

    def _pose(self, row: Mapping[str, Any]) -> None:
        """Log the poses of the root and of the links, and the tips; without a pose the instrument is hidden."""
        rr = self._rerun
        if row["camera_from_root"] is None:
            self._log("instrument", rr.Transform3D(scale=0.0))
            self._log("tips", rr.Clear(recursive=False))
            return
        self._log("instrument", self._transform(np.array(row["camera_from_root"])))
        joints = [row["joints"][name] for name in self._instrument.joint_names]
        for link, pose in zip(self._instrument.links, self._instrument.forward(joints), strict=True):
            self._log(f"instrument/{_part(link.name)}", self._transform(pose))
        self._log("tips", rr.Points3D(row["tips"] or np.zeros((0, 3)), radii=0.0006, colors=_OUTLINE))

    def _say(self, row: Mapping[str, Any]) -> None:
        """Log the status where it changes, and the reasons."""
        status = row["status"]
        if status != self._status or row["reasons"]:
            text = f"{row['frame']}: {status}" + "".join(f"; {reason}" for reason in row["reasons"])
            self._log("reasons", self._rerun.TextLog(text, level=_LEVELS.get(status, "ERROR")))
        self._status = status

    def _transform(self, pose: Float64) -> Any:
        """Return a transform to the parent from a pose (4, 4)."""
        return self._rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])

    def _scalar(self, entity: str, value: float) -> None:
        """Log a number; one that is not known makes a gap."""
        self._log(entity, self._rerun.Scalars(value) if np.isfinite(value) else self._rerun.Clear(recursive=False))

    def _log(self, entity: str, what: Any) -> None:
        self._stream.log(entity, what)

    def _static(self, entity: str, what: Any) -> None:
        self._stream.log(entity, what, static=True)


def _part(name: str) -> str:
    """Return a name as one part of an entity's path."""
    return str(_library().escape_entity_path_part(name))


def _camera_entities(rig: Rig) -> list[str]:
    """Return the entity of each view of a rig."""
    return [_CAMERA if number == 0 else _part(f"{_CAMERA}_{view.name}") for number, view in enumerate(rig.views)]


def _library() -> Any:
    """Import the viewer's library."""
    try:
        import rerun
        import rerun.blueprint
    except ImportError:
        raise missing_library("--rerun", "rerun-sdk") from None
    return rerun


def _blueprint(rig: Rig) -> Any:
    """Return the arrangement of the views."""
    views = _library().blueprint
    curves = [
        views.TimeSeriesView(origin="joints", name="joints, deg"),
        views.TimeSeriesView(origin="offsets", name="offsets, deg: true = reading + offset"),
    ]
    eye = views.EyeControls3D(position=_EYE, look_target=_LOOKED_AT, eye_up=(0, -1, 0))
    entities = _camera_entities(rig)
    seen = [*(f"{entity}/**" for entity in entities), "instrument/**", "tips"]
    names = ["image"] if len(entities) == 1 else rig.names
    pictures = [
        *(
            views.Spatial2DView(origin=entity, contents=[f"{entity}/**"], name=name)
            for entity, name in zip(entities, names, strict=True)
        ),
        views.Spatial3DView(origin="/", contents=seen, name="in the camera's space", eye_controls=eye),
    ]
    rows = [views.Horizontal(*pictures), views.Horizontal(*curves), views.TextLogView(origin="reasons", name="reasons")]
    return views.Blueprint(views.Vertical(*rows, row_shares=[5, 3, 1.5]), collapse_panels=True)
