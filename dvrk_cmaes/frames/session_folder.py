"""Reader of session folders: the frames of one camera with their masks, images and readings.

A session folder contains::

    camera.yaml
    joints.csv
    masks/<frame>.png or images/<frame>.png|jpg, or both
    images.csv (frame, time), ignore/<frame>.png, keypoints.csv, boxes.csv, golden.json (each optional)

Pictures that are not in a folder images lie in the session folder itself, if that has no folder masks; they are
masks if they look like masks.

A stereo session has left.yaml, right.yaml, and masks/left, masks/right, images/left and so on.

Instead of joints.csv, there may be files of the arm's topics, named after them: measured_js.yaml,
jaw_measured_js.csv and so on. The layout of published frames (see ``published_layout``) is read as well; the layout is
recognised by the files in the folder.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

from dvrk_cmaes.camera import Camera, Rig
from dvrk_cmaes.camera.files import CameraFile, Side, guessed_camera, read_camera_file
from dvrk_cmaes.camera.rig_files import read_rig
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.coco_mask import FILES, frames_of
from dvrk_cmaes.frames.frame import FrameFiles, readable
from dvrk_cmaes.frames.images import looks_like_mask, read_image
from dvrk_cmaes.frames.keypoints import Hints, read_boxes, read_keypoints
from dvrk_cmaes.frames.paired_names import counted_apart, named_as, paired, with_masks_beside, with_names_of
from dvrk_cmaes.frames.picture_fit import fitted
from dvrk_cmaes.frames.published_layout import find_published_frames, is_published_layout
from dvrk_cmaes.frames.session_toml import CameraEntry, ToolEntry, read_session_toml
from dvrk_cmaes.frames.truth import SessionTruth, read_golden
from dvrk_cmaes.frames.video_frames import Video, VideoFrame, frame_name
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.io.arguments import PATH, check_type
from dvrk_cmaes.io.files import check_own
from dvrk_cmaes.io.image_header import foreign
from dvrk_cmaes.io.short_text import escaped, listed, natural, no_folder
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.lag import Lag
from dvrk_cmaes.joints.reading import TIME_TOLERANCE, NoneNearError, frame_readings, read_joint_file
from dvrk_cmaes.joints.rows import BY_THEMSELVES, JointFile, ReadAs, number_of
from dvrk_cmaes.joints.series import ReadingSeries
from dvrk_cmaes.joints.times import read_image_times, time_in_name

OVERLAID = "what lies over all pictures and never changes, as texts or a border, is ignored"
"""Note on frames with such pixels."""

WARNED = ("rows and frames differ in number", "paired in order", "masks without", "not read", OVERLAID)
"""Beginnings of the notes of a session that commands warn of: files that may be of other frames, or are not used."""

NO_READINGS = "readings: none"

UNCALIBRATED = "without a calibration: `dvrk-cmaes calibrate FOLDER`, with readings (`dvrk-cmaes help uncalibrated`)"
"""What to do where there is no camera file."""

_COUNTED = 3  # frames from which on their numbers may be those of every N-th image
_MANY = 2  # times as many rows as frames that are the first of them
_VIEWS = ("left", "right")
_CAMERAS = (
    *("camera.yaml", "camera.yml", "camera.xml", "camera.json", "camera.mat", "camera.txt"),
    *("camera_info.yaml", "camera_calibration.txt", "calibration.yaml"),
)
_TABLES = ("images.csv", "keypoints.csv", "boxes.csv", "markers.csv", "poses.csv")
_MASKS = ("masks", "SegmentationClass")  # the latter of CVAT and VOC
_NOT_MASKS = ("images", "ignore", "golden.json", "run.json", "synth.json")
_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
_TOPIC_DUMP = re.compile(r"(.*_)?(measured_js|state_joint_current|state_jaw_current)\.(csv|ya?ml|txt)", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Session:
    """A session: its folder, the rig of its cameras, and its frames sorted by name.

    ``truth`` holds the known poses, if any. ``notes`` describe the recognised formats of folder, camera and readings.
    ``rig`` has both cameras of a stereo session, or the only one; ``camera`` is its first. ``joint_files`` are the
    files of readings, ``image_times`` the times of the images by frame, ns, None if unknown. ``guessed``: that
    there is no camera file, and the camera is a guess.
    """

    folder: Path
    rig: Rig
    frames: tuple[FrameFiles, ...]
    truth: SessionTruth
    notes: tuple[str, ...] = ()
    joint_files: tuple[JointFile, ...] = ()
    image_times: Mapping[str, int | None] = field(default_factory=dict)
    guessed: bool = False

    def __repr__(self) -> str:
        frames, camera = listed(frame.name for frame in self.frames), self.camera
        return f"Session('{self.folder}', {len(self.frames)} frames: {frames}; {camera.width} x {camera.height} px)"

    @property
    def camera(self) -> Camera:
        """The reference camera."""
        return self.rig.camera

    @property
    def view_names(self) -> tuple[str, ...]:
        """Names of the views, which are subfolders of the folders of masks and images; ``.`` for one camera."""
        return self.rig.names if len(self.rig.views) > 1 else (".",)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notes that commands warn of."""
        return tuple(note for note in self.notes if note.startswith(WARNED))

    def reading_series(self) -> ReadingSeries | None:
        """Return all readings as functions of time, with the frames' times; None where there is no common clock.

        None, too, for a wrong cell, which is the ``problem`` of its frame.
        """
        try:
            return ReadingSeries.of_files(self.joint_files, self.image_times)
        except InputError:
            return None

    def with_prompts(self, prompts: Hints) -> Session:
        """Return the session with prompts for the frames that have neither a mask nor a row in boxes.csv.

        Parameters
        ----------
        prompts
            Box and points that show where the instrument is.
        """
        frames = (
            files if files.mask is not None or files.prompts is not None else replace(files, prompts=prompts)
            for files in self.frames
        )
        return replace(self, frames=tuple(frames))

    def with_lag(self, lag: Lag) -> Session:
        """Return the session with each frame's readings of the time of its image less the lag.

        A frame without readings at that time has none, and a note that says so. With a lag of zero, nothing changes.

        Parameters
        ----------
        lag
            The lag of the images behind the readings.

        Raises
        ------
        InputError
            Readings and images have no common clock, the lag is not known in its unit, or a cell of the readings is
            wrong.
        """
        if not (lag.frames or lag.seconds):
            return self
        series = ReadingSeries.of_files(self.joint_files, self.image_times)
        if series is None:
            raise InputError(
                f"{self.folder}: lag: expected readings of numbered frames, or times of images (images.csv) and "
                "readings, to take it out of, got neither"
            )
        note = f"readings of {lag.text} before the image"
        frames = []
        for files in self.frames:
            found = series.of_frame(files.name, lag) if files.name in series.frames else {}
            notes = (*files.notes, note if found else f"no readings of {lag.text} before the image")
            frames.append(replace(files, readings=found, notes=notes, problem=None if found else files.problem))
        return replace(self, frames=tuple(frames), notes=(*self.notes, note))


def read_session(
    folder: str | Path,
    *,
    arm: str | None = None,
    camera: Path | None = None,
    camera_right: Path | None = None,
    rectified: bool = False,
    side: Side = "left",
    known: Iterable[str] = (),
    joints: Sequence[Path | JointFile] | None = (),
    read_as: ReadAs = BY_THEMSELVES,
    masks: Path | None = None,
    video: Video | None = None,
    focal: float | Literal["usual"] | None = None,
) -> Session:
    """Find the frames of a session folder and read its files, except masks and images.

    Every file in ``masks`` or ``images`` is a frame. A frame without a row in joints.csv has no readings. An error in a
    frame's readings is recorded as its ``problem``. What session.toml says counts where no argument says otherwise.

    Parameters
    ----------
    folder
        The session folder, of either layout.
    arm
        An arm that session.toml names: the frames then have its masks and readings, and the other tools' pixels do not
        count. By default the only one; of several, frames are read as if there were no tools.
    camera
        The camera file; the session's camera.yaml by default. Of a stereo session, the file of both eyes or of the
        left one; left.yaml and right.yaml by default, or camera.yaml if that has both eyes.
    camera_right
        The file of the right camera of a stereo session.
    rectified
        Whether the images are rectified.
    side
        ``left`` or ``right``: the camera of a file of both eyes.
    known
        Names of the instrument's joints, as in `ReadAs`.
    joints
        Files of readings, which may have been read already; by default those in the session folder, which may have
        none. None: no readings are used.
    read_as
        How files of readings are read that do not say it.
    masks
        Folder of the masks; ``masks`` in the session folder by default.
    video
        A video that has the images of all frames, of the session layout and one view.
    focal
        The focal length, px, of a camera without a file, or ``usual``: it is guessed where there is no file. By default
        there must be a file.

    Raises
    ------
    InputError
        A file is missing or not valid (the message names it), there are no frames, two files have one frame's name, or
        no frame can be used. A link leads out of the folder. session.toml does not name the arm.
    """
    check_type("folder", folder, PATH, "the path of a session folder")
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{folder}: {no_folder(folder)}; expected a session with camera.yaml, joints.csv and masks")
    entries = read_session_toml(root)
    single = entries.tools[0] if len(entries.tools) == 1 else ToolEntry("")
    tool = single if arm is None else entries.tool(arm)
    said = entries.camera if camera is None else CameraEntry(file=camera)
    said = replace(said, right=camera_right or said.right, rectified=rectified or said.rectified)
    named = masks or tool.masks or (None if tool.label is None else labels_of(root))
    holder, columns = read_as.arm or tool.arm or None, read_as.columns or tool.columns
    read_as = replace(read_as, arm=holder, columns=columns, known=(*known, *read_as.known))
    joints = joints if joints is None or joints or tool.joints is None else (tool.joints,)
    mask_folder = named or _usual_masks(root)
    stereo = _is_stereo(root, mask_folder)
    if named is not None or video is not None or is_session_layout(root) or not is_published_layout(root):
        frames, readings, times, notes = _session_frames(root, mask_folder, joints, read_as, video)
        notes = ("a session folder of two views" if stereo else "a session folder", *notes)
    else:
        frames, readings, times = find_published_frames(root), (), {}
        frames = frames if joints is not None else tuple(replace(frame, readings={}) for frame in frames)
        notes = ("frames in the published layout, a folder each",)
    if said.crop is not None:
        frames = tuple(frame.changed(crop=said.crop) for frame in frames)
    lens, guessed = _lens(root, said, frames, side, focal)
    if not stereo and video is not None and (film := frames[0].video) is not None:
        window = film.video.window(lens.camera, None, side)
        frames = tuple(replace(own, video=own.video and replace(own.video, window=window)) for own in frames)
    lens = fitted(lens, frames[0], stretch=said.stretch)
    golden = root / "golden.json"
    check_own(root, [golden])
    session = Session(
        folder=root,
        rig=lens.rig,
        frames=tuple(replace(frame, notes=(*lens.notes, *frame.notes)) for frame in frames),
        truth=read_golden(golden) if os.path.lexists(golden) else SessionTruth(),
        notes=(*notes, f"camera: {lens.kind}", *lens.notes),
        joint_files=readings,
        image_times=times,
        guessed=guessed,
    )
    shared = masks or labels_of(root) or _usual_masks(root)
    others = [(own, own.masks or shared) for own in entries.tools if own is not tool]
    return session if tool.arm == "" else _of_tool(session, mask_folder, tool, others)


def _lens(
    root: Path, said: CameraEntry, frames: Sequence[FrameFiles], side: Side, focal: float | Literal["usual"] | None
) -> tuple[CameraFile, bool]:
    """Read the cameras of a session's frames, and say whether they are a guess; arguments and errors as `read_session`.

    ``said`` are the files that are named; without any, they are found by their usual names.
    """
    named = said.file or said.left
    path = named or next((root / name for name in _CAMERAS if os.path.lexists(root / name)), root / _CAMERAS[0])
    if any(frame.others for frame in frames):
        if focal not in (None, "usual"):
            raise InputError(
                f"{root}: expected the camera files of both eyes (--camera FILE), which are not guessed, got none"
            )
        right = said.right
        if named is None and right is None and os.path.lexists(root / "left.yaml"):
            path, right = root / "left.yaml", root / "right.yaml"
        check_own(root, (path, right))
        parts = (part for frame in frames for part in (frame, *frame.others.values()))
        first = next((part for part in parts if part.mask or part.has_image), frames[0])
        return read_rig(path, right, rectified=said.rectified, size=lambda: first.size), False
    if said.right is not None:
        raise InputError(
            f"{root}: expected a stereo session (masks/left) with a right camera, got one of a single view"
        )
    there = named is not None or os.path.lexists(path)
    if focal is not None and (focal != "usual" or not there):
        return guessed_camera(frames[0].size, None if focal == "usual" else focal), True
    check_own(root, [path])
    if not there:
        raise InputError(f"{path}: no such file; expected a camera file (--camera FILE); {UNCALIBRATED}")
    return read_camera_file(path, rectified=said.rectified, side=side, size=lambda: frames[0].size), False


def labels_of(root: Path) -> Path | None:
    """Return a session's folder of labels, which has the masks of a tool with a label if there is no folder masks."""
    return root / "labels" if (root / "labels").is_dir() and not (root / "masks").exists() else None


def _usual_masks(root: Path) -> Path:
    """Return the folder of masks of a session that names none, which need not be there."""
    return next((root / name for name in _MASKS if (root / name).is_dir()), root / _MASKS[0])


def _of_tool(session: Session, read: Path, tool: ToolEntry, others: Sequence[tuple[ToolEntry, Path]]) -> Session:
    """Return a session with the masks of one tool only; the pixels of the others, each in its folder, do not count.

    ``session`` was ``read`` with the masks in the tool's own folder. Another tool may be before or behind this one, so
    its pixels have no information on it, neither as instrument nor as background.

    Raises
    ------
    InputError
        The folder of masks of another tool has none, or one is a link that leaves the session.
    """
    masks: dict[str, Mapping[str, Mapping[str, Path]]] = {}
    for other, folder in others:
        if folder != read:
            masks[other.arm] = {view: image_files(folder / view) for view in session.view_names}
            check_own(session.folder, (path for of_view in masks[other.arm].values() for path in of_view.values()))
            if not any(masks[other.arm].values()):
                raise InputError(f"{folder}: expected masks (PNG or JPEG) of {other.arm}, got none")

    def of_view(files: FrameFiles, view: str) -> FrameFiles:
        """Return the files of one view of a frame for the tool, with those of its further views."""
        own = (
            (other, masks[other.arm][view].get(files.name) if folder != read else files.mask)
            for other, folder in others
        )
        hiding = (FrameFiles(files.name, mask, label=other.label, pick=other.pick) for other, mask in own if mask)
        more = {name: of_view(each, name) for name, each in files.others.items()}
        return replace(files, label=tool.label, pick=tool.pick, other_tools=tuple(hiding), others=more)

    return replace(session, frames=tuple(of_view(files, session.view_names[0]) for files in session.frames))


def _is_stereo(root: Path, masks: Path) -> bool:
    """Whether a session folder has masks or images of a left and a right view."""
    return any((folder / view).is_dir() for folder in (masks, root / "images") for view in _VIEWS)


def is_session_layout(root: Path) -> bool:
    """Whether a folder has a folder of masks, or ``images``."""
    return any((root / name).is_dir() for name in (*_MASKS, "images"))


def _masks_as_json(root: Path, folder: Path) -> Mapping[str, Path]:
    """Find masks as JSON by frame name: a file for each frame, or one for all."""
    found = {path.stem: path for path in sorted(folder.glob("*.json"), key=lambda path: natural(path.name))}
    whole = next((root / name for name in FILES if (root / name).is_file()), None)
    check_own(root, [whole])
    return found if found or whole is None else dict.fromkeys(frames_of(whole), whole)


class _Pictures(NamedTuple):
    """The files of a view by name of the frame."""

    masks: Mapping[str, Path]
    images: Mapping[str, Path]
    ignored: Mapping[str, Path]


def _pictures(root: Path, mask_folder: Path, *, filmed: bool) -> list[_Pictures]:
    """Find the pictures of each view; InputError if there are neither masks nor images, and no video either.

    Images lie in the folder images, or in the session folder itself where it has pictures alone.
    """
    alone = not filmed and not is_session_layout(root) and image_files(root)
    folders = mask_folder, root if alone else root / "images", root / "ignore"
    check_own(root, folders)
    for folder in folders:
        if folder.is_symlink() and not folder.exists():
            raise InputError(f"{folder}: expected a folder, got a link to nothing")
    views = _VIEWS if _is_stereo(root, mask_folder) else (".",)
    first, *further = (_Pictures(*(image_files(folder / view) for folder in folders)) for view in views)
    if not further and not first.masks:
        inner = [path for path in mask_folder.iterdir() if path.is_dir()] if mask_folder.is_dir() else []
        masks = (image_files(inner[0]) if len(inner) == 1 else {}) or _masks_as_json(root, mask_folder)
        if not masks:
            _refuse_annotations(root, mask_folder, inner)
        first = first._replace(masks=masks)
    check_own(root, (path for own in (first, *further) for of_kind in own for path in of_kind.values()))
    if alone:
        if both := with_masks_beside(first.images):
            raise InputError(f"{root}: expected folders images and masks, got both kinds in one: {listed(both)}")
        pictures = [*first.images.values()]
        middle = readable(partial(read_image, pictures[len(pictures) // 2]))
        if not first.masks and middle is not None and looks_like_mask(middle):
            first = first._replace(masks=first.images, images={})
    if not filmed and not any(own.masks or own.images for own in (first, *further)):
        known = mask_folder != root / "masks" or is_session_layout(root)
        if not known and (inside := sorted(path.name for path in root.iterdir())):
            raise InputError(
                f"{root}: expected folders masks or images, or those that session.toml names, or pictures, got "
                f"{listed(inside)}"
            )
        raise InputError(f"{mask_folder}: expected masks (PNG or JPEG) of the frames, got {_other_files(mask_folder)}")
    return [first, *further]


def _with_readings(frame: FrameFiles, files: Sequence[JointFile], time: int | None) -> tuple[FrameFiles, int | None]:
    """Return a frame with its readings, and the farthest of these in time, ns; or with the problem that it has."""
    odd = [path for path in (frame.mask, frame.image) if path is not None and escaped(path.name) != path.name]
    if odd:
        problem = f"{escaped(str(odd[0]))}: expected a name in UTF-8 without control characters: rename it"
        return FrameFiles(frame.name, None, time=frame.time, problem=problem), None
    try:
        readings, notes, farthest = frame_readings(files, frame.name, time=time)
    except InputError as error:
        return replace(frame, problem=str(error), without_reading=isinstance(error, NoneNearError)), None
    return replace(frame, readings=readings, notes=notes), farthest


def _session_frames(
    root: Path, mask_folder: Path, joints: Sequence[Path | JointFile] | None, read_as: ReadAs, video: Video | None
) -> tuple[tuple[FrameFiles, ...], tuple[JointFile, ...], dict[str, int | None], tuple[str, ...]]:
    """Find the frames of the session layout, its files of readings, the images' times, and notes on the formats."""
    of_views = _pictures(root, mask_folder, filmed=video is not None)
    masks, images, _ = of_views[0]
    sources = () if joints is None else joints or _joint_files(root)
    check_own(root, (source for source in sources if isinstance(source, Path)))
    files = [read_joint_file(source, read_as=read_as) for source in sources]
    of_frames = [file.names for file in files if file.labels == "frame"]
    rows = of_frames[0] if len(of_frames) == 1 else {name: 0 for names in of_frames for name in names}
    of_kinds, like = {"masks": masks, "rows of readings": rows}, images or masks
    apart = [f"{kind} {listed(names, 1)}" for kind, names in of_kinds.items() if counted_apart(names, like)]
    named = [with_names_of(mask_folder, own.masks, own.images, rows) for own in of_views]
    in_data_set = {frame: name for name, frame in named[0].items()}
    of_masks = [{met[name]: path for name, path in own.masks.items()} for own, met in zip(of_views, named, strict=True)]
    masks = of_masks[0]
    films = {} if video is None else _filmed(video, files, tuple(masks))
    of_masks[1:] = [named_as({**masks, **images}, own) for own in of_masks[1:]]
    of_images = [images, *(named_as({**masks, **images}, own.images) for own in of_views[1:])]
    names = sorted({*films}.union(*of_masks, *of_images), key=natural)
    of_ignored = [named_as(names, own.ignored) for own in of_views]
    times, tips, boxes = _tables(root, names)
    if films and all(file.labels != "frame" for file in files):  # else the times are those of the rows
        times = {name: film.video.times[film.number] for name, film in films.items()}
    image_times = {name: times.get(name, time_in_name(name)) for name in names}
    files = [_by_frame(file, image_times, read_as) for file in files]
    remarks = [f"paired in order with as many files {listed(like, 1)}: {' and '.join(apart)}"] if apart else []
    if unused := [*_unused(root, masks=not masks, joints=joints is not None and not files)]:
        remarks.append(f"not read: {listed(unused)}: session.toml can name masks and joints, or rename it")
    others: dict[str, Mapping[str, object]] = dict(zip(_TABLES, (times, tips, boxes), strict=False))
    others["ignore"] = of_ignored[0]
    if lost := [each for each, of_each in others.items() if of_each and not {*names} & of_each.keys()]:
        remarks.append(f"not read: {listed(lost)}: none of its names or numbers is a frame's")
    if images and (alone := [name for name in masks if name not in images and name not in rows]):
        remarks.append(f"masks without an image or a row of readings: {listed(alone)}")
    frames, distances = list[FrameFiles](), list[int]()
    for name, time in image_times.items():
        moments = [time, *(file.time(name) for file in files if file.labels == "frame")]
        first, *further = (
            FrameFiles(name, own.get(name), image=shown.get(name), ignore=ignored.get(name))
            for own, shown, ignored in zip(of_masks, of_images, of_ignored, strict=True)
        )
        frame = replace(
            first,
            mask_name=in_data_set.get(name, name),
            keypoints=tips.get(name),
            time=next((each / NANOSECONDS for each in moments if each is not None), None),
            others=dict(zip(_VIEWS[1:], further, strict=False)),
            prompts=boxes.get(name),
            video=films.get(name),
        )
        frame, farthest = _with_readings(frame, files, time)
        frames.append(frame)
        distances += [] if farthest is None else [farthest]
    if all(frame.problem for frame in frames):
        raise InputError(str(frames[0].problem))
    notes = [text for file in files for text in (f"readings: {file.kind}", *file.notes)] or [NO_READINGS]
    if distances:
        away = f"at most {max(distances) / NANOSECONDS:.3g} s away ({TIME_TOLERANCE / NANOSECONDS:g} s are allowed)"
        remarks.append(f"readings interpolated to the images' times, from {away}")
    return tuple(frames), tuple(files), image_times, (*notes, *remarks)


def _tables(root: Path, names: Sequence[str]) -> tuple[dict[str, int], dict[str, Float64], dict[str, Hints]]:
    """Read the times of images, the jaw tips and the boxes of a session by frame; of those that it does not have, none.

    Names that are no frame's stay as they are.
    """
    paths = [root / name for name in _TABLES[:3]]
    check_own(root, paths)
    there = [os.path.lexists(path) for path in paths]  # a broken link is an error, not a missing file
    times = read_image_times(paths[0]) if there[0] else {}
    tips = read_keypoints(paths[1]) if there[1] else {}
    boxes = read_boxes(paths[2]) if there[2] else {}
    return named_as(names, times), named_as(names, tips), named_as(names, boxes)


def _unused(root: Path, *, masks: bool, joints: bool) -> Iterator[str]:
    """Yield what a session folder has under other names than those that are read: of masks, and of readings."""
    for path in sorted(root.iterdir()) if masks or joints else ():
        pictures = path.is_dir() and any(inner.suffix.lower() in _IMAGE_SUFFIXES for inner in path.iterdir())
        of_masks = (pictures or path.suffix == ".json") and path.name not in _NOT_MASKS
        if (masks and of_masks) or (joints and path.suffix.lower() == ".csv" and path.name not in _TABLES):
            yield path.name


def _filmed(video: Video, files: Sequence[JointFile], masks: Sequence[str]) -> dict[str, VideoFrame]:
    """Return the frames of a video by name: that of their masks, or of their rows in the readings, or their numbers.

    Raises
    ------
    InputError
        The readings have rows of named frames, but not one for each frame of the video.
    """
    count = len(video.times)
    rows = next((tuple(file.names) for file in files if file.labels == "frame"), None)
    if len(masks) != count and rows is not None and len(rows) != count:
        raise InputError(f"{video.path}: expected {len(rows)} frames, as joints.csv has, got {count}")
    names = masks if len(masks) == count else rows or [*map(frame_name, range(count))]
    return {name: VideoFrame(video, number, (0, 0, *video.size)) for number, name in enumerate(names)}


def _other_files(folder: Path) -> str:
    """Say what is in a folder of masks that has none, and what to do."""
    if not folder.is_dir():
        return "none"
    others = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    folders = [path.name for path in others if path.is_dir() and any(image_files(path))]
    if folders:
        return f'folders: {listed(folders, 3)} (session.toml says which: masks = "masks/{folders[0]}" of a [[tool]])'
    first = next((path for path in others if path.is_file()), None)
    return "none" if first is None else f"{first.name}, {foreign(first.read_bytes())}"


def _refuse_annotations(root: Path, folder: Path, inner: Sequence[Path]) -> None:
    """Raise an InputError for a session without masks that has an annotator's files, or masks in ``inner`` folders."""
    if any(map(image_files, inner)):
        raise InputError(f"{folder}: expected masks (PNG or JPEG) of the frames, got {_other_files(folder)}")
    places = (root / "annotations.xml", *sorted((root / "labels").glob("*.txt")), *sorted(folder.glob("*.*")))
    for path in (path for path in places if path.is_file() and not path.name.startswith(".")):
        raise InputError(f"{path}: expected masks (PNG or JPEG, or masks.json), got {foreign(path.read_bytes())}")


def _by_frame(file: JointFile, image_times: Mapping[str, int | None], read_as: ReadAs) -> JointFile:
    """Return a file of readings by the names of the frames, with a note where its rows seem to be of other images.

    Raises
    ------
    InputError
        No row has a frame's name, and no times say which row is a frame's.
    """
    frames, labels = list(image_times), file.names
    if file.labels == "message" or (file.timed and any(time is not None for time in image_times.values())):
        return file
    apart = file.labels == "number" and counted_apart(frames, labels)
    offset = (1 if number_of(frames[0]) == 0 else -1) if apart and read_as.offset is None else read_as.offset
    if offset is not None:
        return file.by_number(frames, offset, read_as.step)
    if file.labels == "frame":
        rows = {row: name for name, row in paired(frames, labels).items() if row != name}
        file = replace(file, names={rows.get(row, row): labels[row] for row in labels}) if rows else file
    common = [name for name in frames if (name if file.labels == "frame" else str(number_of(name))) in file.names]
    if not common and len(frames) > 1:  # a single frame may lack readings
        raise InputError(
            f"{file.path}: none of {len(labels)} rows ({listed(labels, 2)}) has a frame's name "
            f"({listed(frames, 2)}): say which row frame 0 has (--frame-offset), and how many rows a frame is from "
            "the next one (--frame-step), or give the times of images (images.csv) and rows (a column time)"
        )
    counted = [number_of(name) for name in frames] in ([*range(len(frames))], [*range(1, len(frames) + 1)])
    if not counted or not len(common) == len(frames) >= _COUNTED or len(labels) < _MANY * len(frames):
        return file
    note = f"{len(frames)} frames have the names of the first of {len(labels)} rows of {Path(file.path).name}"
    advice = "if they are every N-th image, say --frame-offset 0 --frame-step N"
    return replace(file, notes=(*file.notes, f"{WARNED[0]}: {note}; {advice}"))


def _joint_files(root: Path) -> list[Path]:
    """List the files of readings of a session: its joints.csv, or else those named after topics of an arm, if any."""
    joints_csv = root / "joints.csv"
    if os.path.lexists(joints_csv):
        return [joints_csv]
    folders = [root, *(path for path in (root / "jaw",) if path.is_dir())]
    return [path for folder in folders for path in sorted(folder.iterdir()) if _TOPIC_DUMP.fullmatch(path.name)]


def find_images(folder: str | Path) -> dict[str, Path]:
    """Find the images of a session of either layout, or all images of another folder, by frame name, sorted.

    Those of a stereo session are named by view and frame, such as left/0000. The folder need not have a camera, masks
    or readings. Links that lead out of it are refused.

    Raises
    ------
    InputError
        There is no such folder, it has no images, or it has two images of one frame.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"{folder}: {no_folder(folder)}; expected images, or a session with images")
    if not is_session_layout(root) and is_published_layout(root):
        found = {frame.name: frame.image for frame in find_published_frames(root) if frame.image is not None}
    elif any((root / "images" / view).is_dir() for view in _VIEWS):
        views = {view: image_files(root / "images" / view) for view in _VIEWS}
        found = {f"{view}/{name}": path for view, of_view in views.items() for name, path in of_view.items()}
    else:
        found = dict(image_files(root / "images" if (root / "images").is_dir() else root))
    if not found:
        raise InputError(f"{folder}: expected images (PNG or JPEG), got none")
    check_own(root, found.values())
    return found


def image_files(folder: Path) -> Mapping[str, Path]:
    """Find the PNG and JPEG files of a folder by frame name, their stem; none if the folder does not exist."""
    if not folder.is_dir():
        return {}
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir(), key=lambda path: natural(path.name)):
        if path.suffix.lower() not in _IMAGE_SUFFIXES or path.name.startswith("."):
            continue
        name = escaped(path.stem)
        if name in found:
            raise InputError(f"{path}: expected one file for frame {name}, got {found[name].name} too")
        found[name] = path
    return found
