"""``dvrk-cmaes segment``: masks of the instrument in images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    FRAME,
    MOST_PROCESSES,
    OUTPUT,
    SEGMENT,
    Flag,
    InstrumentOptions,
    SegmentOptions,
    SessionOptions,
    whole,
)
from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line, answer, exit_code, note
from dvrk_cmaes.errors import DvrkCmaesError, InputError

if TYPE_CHECKING:
    from dvrk_cmaes.camera import Rig
    from dvrk_cmaes.frames.frame import FrameFiles
    from dvrk_cmaes.runs.frame import ArmInSession
    from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings
    from dvrk_cmaes.silhouette import Body


def segment(
    source: Annotated[Path, Parameter(group=FRAME)],
    /,
    *,
    model: SegmentOptions = SegmentOptions(),
    instrument: Annotated[str | None, Parameter(group=SEGMENT)] = None,
    threads: Annotated[int, whole(1, MOST_PROCESSES, group=OUTPUT)] = 2,
    out: Annotated[Path, Parameter(group=OUTPUT)] = Path("dvrk-cmaes-masks"),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Find the instrument in an image, or in each image of a folder.

    Writes OUT/masks/FRAME.png, and OUT/overlays/FRAME.jpg for inspection. The model classic looks for the instrument's
    shape, whatever its colours: straight edges of the shaft, with wrist and jaws that look unlike what is around them.
    Of several instruments the surest one is taken, unless a box or a point says which; the masks of the others are
    OUT/others/FRAME-2.png and so on. Where no shape is found, it takes what is grey before a colourful background, or
    what differs from a smooth one; in a folder with at least 6 images of a camera that stands still, what differs from
    the background that these show comes first. In a folder, the same prompts are used for every image.

    Of a session folder with readings, these and its camera are used. Without prompts, images whose masks do not agree
    with most others on where the arm's base is are looked at again, where these expect the instrument.

    `estimate` and `batch` find masks in images themselves, and more accurately, because they use the instrument's
    shape. Of a stereo session, the images of both eyes are segmented, into OUT/masks/left and OUT/masks/right.

    Exit codes: 0 ok, 1 failed, as is a folder without any mask found, 2 wrong usage or input, 3 a mask is a guess (its
    confidence is low), or no mask was found in some images of a folder.

    Example:

    ```
    dvrk-cmaes segment images/0026.png --box 250,180,639,380 --out x
    ```

    Parameters
    ----------
    source
        Image (PNG or JPEG), session folder, folder of images, or a pattern in quotes, such as "pictures/*.jpg".
    model
        The segmentation model, and prompts; in a folder, the same for every image.
    instrument
        Name of a bundled instrument, or path of a URDF. By default that of the session's session.toml, or else lnd.
    threads
        Number of threads.
    out
        Folder for the files written: a new one, or one of this command. Masks that were corrected there by hand since
        are not replaced.
    json
        Print only a summary, as JSON, on stdout.
    """
    import cv2

    from dvrk_cmaes.cli.session_tools import pictures_at
    from dvrk_cmaes.frames.session_folder import find_images
    from dvrk_cmaes.io.output import remove, whole_folder
    from dvrk_cmaes.runs.agreement import expected_by_masks
    from dvrk_cmaes.runs.backgrounds import with_backgrounds
    from dvrk_cmaes.segment.segmentation import Hints
    from dvrk_cmaes.silhouette.prepare import prepare

    hints, body = model.hints(), prepare(instrument or "lnd")  # before any image is read
    cv2.setNumThreads(threads)
    folder, pattern = pictures_at(source)
    single = source.is_file() or not folder.is_dir()
    images = {source.stem: source} if single else find_images(folder)
    images = {name: path for name, path in images.items() if fnmatch(name, pattern or "*")}
    if not images:
        raise InputError(f"{source}: expected images (PNG or JPEG), got none")
    names = {frame.rpartition("/")[2] for frame in images}
    arm = None if single or model.model != "classic" else _with_readings(folder, names, instrument, threads)
    todo = pictures = _pictures(images, arm, hints, out)
    views: dict[str, list[FrameFiles]] = {}
    for frame, files in pictures.items():
        views.setdefault(frame.rpartition("/")[0], []).append(files)
    settings = with_backgrounds(model.resolve(), views)
    with whole_folder(out, "segment", overwrite=True, kept=("masks", "overlays")) as temporary:
        for text in settings.notes:
            note(text)
        rig, body = (None, body) if arm is None else (arm.session.rig, arm.body)
        written, found = dict[str, dict[str, Path]](), dict[str, dict[str, Any]]()
        while todo:
            for frame, files in todo.items():
                try:
                    paths, now = segment_file(frame, files, rig, body, settings, threads, temporary)
                except DvrkCmaesError as error:
                    if single:
                        raise
                    found.setdefault(frame, {"status": "failed", "reason": str(error)})
                    continue
                for path in {*written.get(frame, {}).values()} - {*paths.values()}:
                    remove(temporary / path)
                written[frame], found[frame] = paths, now | {kind: str(out / path) for kind, path in paths.items()}
            starts = {}
            if arm is not None and hints == Hints() and todo is pictures:
                arm = replace(arm, method=replace(arm.method, segment=settings))
                starts = {files.name: files.start for files in expected_by_masks(arm, temporary, note)}
            again = {frame: files for frame, files in pictures.items() if files.name in starts}
            todo = {frame: replace(files, start=starts[files.name]) for frame, files in again.items()}
    document = {"model": settings.model, "out": str(out), "frames": found}
    answer(document, (line for frame, of_frame in found.items() for line in _lines(frame, of_frame)), json=json)
    return exit_code(of_frame["status"] for of_frame in found.values())


def _with_readings(folder: Path, names: set[str], instrument: str | None, threads: int) -> ArmInSession | None:
    """Return a session folder's arm as some frames see it, without masks; None where no readings of it can be used."""
    from dvrk_cmaes.cli.session_tools import open_session

    if not any((folder / name).exists() for name in ("joints.csv", "session.toml")):
        return None
    given = SessionOptions(instrument=InstrumentOptions(instrument=instrument))
    try:
        (arm,) = open_session(folder, given, single=True, ahead=False, together=True).values()
    except InputError as error:
        note(f"images alone are used: {error}")
        return None
    frames = tuple(files.changed(mask=None) for files in arm.session.frames if files.name in names)
    if not any(files.readings for files in frames) or any(files.crop is not None for files in frames):
        return None
    arm = replace(arm, session=replace(arm.session, frames=frames))
    return arm.with_config(replace(arm.method.config, threads=threads))


def _pictures(images: Mapping[str, Path], arm: ArmInSession | None, hints: Hints, out: Path) -> dict[str, FrameFiles]:
    """Return the files of each image, with prompts and what a session says; InputError for a name as no output has."""
    from dvrk_cmaes.frames.frame import FrameFiles
    from dvrk_cmaes.results.folder import check_output

    known, pictures = {} if arm is None else {files.name: files for files in arm.session.frames}, {}
    for frame, path in images.items():
        name = frame.rpartition("/")[2]
        check_output(out, name)
        pictures[frame] = replace(known.get(name, FrameFiles(name, None)), image=path, prompts=hints, others={})
    return pictures


def segment_file(
    frame: str, files: FrameFiles, rig: Rig | None, body: Body, settings: SegmentSettings, threads: int, out: Path
) -> tuple[dict[str, Path], dict[str, Any]]:
    """Segment one image and write the overlay and, as the last file, the mask.

    Returns the files by kind, relative to ``out``, and what was found, for JSON. ``doubtful`` is a mask whose
    confidence is below that of a guess.
    """
    from time import perf_counter

    import numpy as np

    from dvrk_cmaes.camera import View
    from dvrk_cmaes.draw.track_overlay import draw_track
    from dvrk_cmaes.estimation.image_frame import segment_view
    from dvrk_cmaes.frames.images import match_size
    from dvrk_cmaes.frames.seen_view import SeenView
    from dvrk_cmaes.io.json_file import write_image
    from dvrk_cmaes.results.folder import mask_path, overlay_path
    from dvrk_cmaes.results.tracked import TrackView
    from dvrk_cmaes.segment.by_model import assumed_camera
    from dvrk_cmaes.segment.segmentation import GUESS

    name, image = frame.rpartition("/")[0], files.read_image()
    assert image is not None
    started = perf_counter()
    known = None if rig is None else rig.view(name) if name else rig.views[0]
    known = known or View(name, assumed_camera(*image.shape[1::-1]), np.eye(4))
    camera, _ = match_size(known.camera, image.shape[:2], "image", f"{files.image}: ")
    view = SeenView.of(replace(known, name=name, camera=camera), None, image=image)
    found = segment_view(view, files, files.hints, body, settings, threads)
    seconds = perf_counter() - started
    if not found.mask.any():
        raise DvrkCmaesError(f"{files.image}: no instrument found; a box or a point on the instrument would help")
    here = Path()
    written = {"mask": mask_path(here, frame), "overlay": overlay_path(here, frame)}
    status = "doubtful" if found.confidence < GUESS else "ok"
    text = "; ".join([f"confidence {found.confidence:.2f}", *found.notes])
    shown = TrackView(image, found.mask, None, image.shape[1::-1])
    write_image(out / written["overlay"], draw_track([shown], frame=frame, status=status, reasons=[text]))
    for number, other in enumerate(found.others, start=2):
        written[f"mask_{number}"] = Path("others", f"{frame}-{number}.png")
        write_image(out / written[f"mask_{number}"], other.mask)
    write_image(out / written["mask"], found.mask)
    return written, {
        "status": status,
        "confidence": round(found.confidence, 4),
        "share": round(float(found.mask.mean()), 6),
        "before": found.before,
        "notes": list(found.notes),
        "seconds": round(seconds, 4),
    }


def _lines(frame: str, found: Mapping[str, Any]) -> Iterator[Line]:
    """Yield the lines of one image: confidence, area, notes and the files written."""
    style = STATUS_STYLES[found["status"]]
    if found["status"] == "failed":
        yield Line(f"{frame}: failed: {found['reason']}", style)
        return
    before = "" if found["before"] is None else f", by its {found['before']}"
    word = "a guess, " if found["status"] == "doubtful" else ""
    area = f"{100 * found['share']:.1f} % of the image{before}"
    yield Line(f"{frame}: {word}confidence {found['confidence']:.2f}, {area}, {found['seconds']:.2f} s", style)
    yield from (Line(f"  {text}") for text in found["notes"])
    kinds = [kind for kind in found if kind in ("mask", "overlay") or kind.startswith("mask_")]
    yield Line("  " + "   ".join(f"{kind}: {found[kind]}" for kind in kinds))
