"""``dvrk-cmaes segment``: masks of the instrument in images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dvrk_cmaes.cli.options import FRAME, MOST_PROCESSES, OUTPUT, SEGMENT, Flag, SegmentOptions, whole
from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line, answer, exit_code, note
from dvrk_cmaes.errors import DvrkCmaesError, InputError

if TYPE_CHECKING:
    from dvrk_cmaes.segment.segmentation import Hints, SegmentSettings


def segment(
    source: Annotated[Path, Parameter(group=FRAME)],
    /,
    *,
    model: SegmentOptions = SegmentOptions(),
    instrument: Annotated[str, Parameter(group=SEGMENT)] = "lnd",
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
        Name of a bundled instrument, or path of a URDF.
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
    from dvrk_cmaes.frames.frame import FrameFiles
    from dvrk_cmaes.frames.session_folder import find_images
    from dvrk_cmaes.io.output import whole_folder
    from dvrk_cmaes.results.folder import check_output
    from dvrk_cmaes.runs.backgrounds import with_backgrounds
    from dvrk_cmaes.silhouette.prepare import prepare

    hints = model.hints()
    prepare(instrument)  # before any image is read, and cached
    cv2.setNumThreads(threads)
    folder, pattern = pictures_at(source)
    single = source.is_file() or not folder.is_dir()
    images = {source.stem: source} if single else find_images(folder)
    images = {name: path for name, path in images.items() if fnmatch(name, pattern or "*")}
    if not images:
        raise InputError(f"{source}: expected images (PNG or JPEG), got none")
    views: dict[str, list[FrameFiles]] = {}
    for frame, path in images.items():
        view, _, name = frame.rpartition("/")
        check_output(out, name)
        views.setdefault(view, []).append(FrameFiles(name, None, image=path))
    settings = with_backgrounds(model.resolve(), views)
    with whole_folder(out, "segment", overwrite=True, kept=("masks", "overlays")) as temporary:
        for text in settings.notes:
            note(text)
        found = {}
        for frame, path in images.items():
            try:
                files, found[frame] = segment_file(frame, path, settings, hints, threads, temporary, instrument)
                found[frame] |= {kind: str(out / path) for kind, path in files.items()}
            except DvrkCmaesError as error:
                if single:
                    raise
                found[frame] = {"status": "failed", "reason": str(error)}
    document = {"model": settings.model, "out": str(out), "frames": found}
    answer(document, (line for frame, of_frame in found.items() for line in _lines(frame, of_frame)), json=json)
    return exit_code(of_frame["status"] for of_frame in found.values())


def segment_file(
    frame: str, path: Path, settings: SegmentSettings, hints: Hints, threads: int, out: Path, instrument: str
) -> tuple[dict[str, Path], dict[str, Any]]:
    """Segment one image and write the overlay and, as the last file, the mask.

    Returns the files by kind, relative to ``out``, and what was found, for JSON. ``doubtful`` is a mask whose
    confidence is below that of a guess.
    """
    from time import perf_counter

    from dvrk_cmaes.draw.track_overlay import draw_track
    from dvrk_cmaes.frames.images import read_image
    from dvrk_cmaes.io.json_file import write_image
    from dvrk_cmaes.results.folder import mask_path, overlay_path
    from dvrk_cmaes.results.tracked import TrackView
    from dvrk_cmaes.segment import segment as segment_image
    from dvrk_cmaes.segment.segmentation import GUESS

    image = read_image(path)
    started = perf_counter()
    background = settings.backgrounds.get(frame.rpartition("/")[0])
    found = segment_image(
        image,
        model=settings.model,
        weights=settings.weights,
        threads=threads,
        background=background,
        instrument=instrument,
        **vars(hints),
    )
    seconds = perf_counter() - started
    if not found.mask.any():
        raise DvrkCmaesError(f"{path}: no instrument found; a box or a point on the instrument would help")
    here = Path()
    files = {"mask": mask_path(here, frame), "overlay": overlay_path(here, frame)}
    status = "doubtful" if found.confidence < GUESS else "ok"
    text = "; ".join([f"confidence {found.confidence:.2f}", *found.notes])
    shown = TrackView(image, found.mask, None, image.shape[1::-1])
    write_image(out / files["overlay"], draw_track([shown], frame=frame, status=status, reasons=[text]))
    for number, other in enumerate(found.others, start=2):
        files[f"mask_{number}"] = Path("others", f"{frame}-{number}.png")
        write_image(out / files[f"mask_{number}"], other.mask)
    write_image(out / files["mask"], found.mask)
    return files, {
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
