"""``dvrk-cmaes segment``: from images to masks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from dvrk_cmaes.cli.options import (
    DEFAULT_PROMPTS,
    DEFAULT_SEGMENT,
    FRAME,
    OUTPUT,
    Flag,
    PromptOptions,
    SegmentOptions,
)
from dvrk_cmaes.cli.terminal import STATUS_STYLES, Line, show
from dvrk_cmaes.errors import DvrkCmaesError, InputError

if TYPE_CHECKING:
    from dvrk_cmaes.segment import Segmentation
    from dvrk_cmaes.segment.with_instrument import Hints, SegmentSettings

_DOUBTFUL = 3


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one image: the mask and the files written, or why there is none."""

    frame: str
    found: Segmentation | None
    written: dict[str, Path]
    seconds: float = 0.0
    problem: str = ""

    @property
    def status(self) -> str:
        """``ok``, ``doubtful`` for a guess, or ``failed``."""
        from dvrk_cmaes.segment.confidence import GUESS

        if self.found is None:
            return "failed"
        return "doubtful" if self.found.confidence < GUESS else "ok"

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        if self.found is None:
            return {"status": "failed", "reason": self.problem}
        return {
            "status": self.status,
            "confidence": round(self.found.confidence, 4),
            "share": round(float(self.found.mask.mean()), 6),
            "notes": list(self.found.notes),
            **{kind: str(path) for kind, path in self.written.items()},
            "seconds": round(self.seconds, 4),
        }


def segment(
    source: Annotated[Path, Parameter(group=FRAME)],
    /,
    *,
    model: SegmentOptions = DEFAULT_SEGMENT,
    prompts: PromptOptions = DEFAULT_PROMPTS,
    threads: Annotated[int, Parameter(group=OUTPUT)] = 2,
    out: Annotated[Path, Parameter(group=OUTPUT)] = Path("dvrk-cmaes-masks"),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Find the instrument in an image, or in each image of a folder.

    Writes OUT/masks/FRAME.png, OUT/overlays/FRAME.jpg to judge it by, and, where the model has one, a soft score
    OUT/scores/FRAME.png (128 and more is instrument). With nothing but the image, an instrument is what is grey before
    something colourful and comes in from the border: give a box or a point where that is not so.

    `estimate` and `batch` do better, since they know the instrument's shape: they find masks themselves.

    Exit codes: 0 ok, 1 failed, 2 wrong usage or input, 3 a mask is a guess, or in a folder, one was not found.

    Example:

    `dvrk-cmaes segment images/0026.png --box 250,180,639,380 --out x`

    Parameters
    ----------
    source
        An image (PNG or JPEG), a session folder, or a folder of images.
    model
        How the mask is found.
    prompts
        Where the instrument is; in a folder, the same for every image.
    threads
        How many threads to use.
    out
        Folder to write to. A session's masks are not replaced.
    json
        Print what was found as JSON, and nothing else, on stdout.
    """
    if threads < 1:
        raise InputError(f"--threads: expected a whole number of at least 1, got {threads}")
    import cv2

    from dvrk_cmaes.frames.session_folder import find_images
    from dvrk_cmaes.io.atomic import json_text
    from dvrk_cmaes.results.paths import check_output, mask_path

    settings, hints = model.resolve(), prompts.resolve()
    cv2.setNumThreads(threads)
    single = not source.is_dir()
    images = {source.stem: source} if single else find_images(source)
    for frame in images:
        check_output(out, frame)
        if not single and out.absolute() == source.absolute() and mask_path(out, frame).exists():
            raise InputError(f"--out: expected another folder than the session's, which has {mask_path(out, frame)}")
    outcomes = []
    for frame, path in images.items():
        try:
            outcomes.append(_segment(frame, path, settings, hints, threads, out))
        except DvrkCmaesError as error:
            if single:
                raise
            outcomes.append(Outcome(frame, None, {}, problem=str(error)))
    if json:
        document = {"model": settings.model, "out": str(out), "frames": {o.frame: o.to_dict() for o in outcomes}}
        print(json_text(document), end="")
    else:
        show(line for outcome in outcomes for line in _lines(outcome))
    return 0 if all(outcome.status == "ok" for outcome in outcomes) else _DOUBTFUL


def _segment(frame: str, path: Path, settings: SegmentSettings, hints: Hints, threads: int, out: Path) -> Outcome:
    """Segment one image and write what was found, the mask last."""
    from time import perf_counter

    import numpy as np

    from dvrk_cmaes.frames.images import read_image
    from dvrk_cmaes.io.atomic import write_image
    from dvrk_cmaes.results.paths import mask_path, overlay_path
    from dvrk_cmaes.segment import segment as find
    from dvrk_cmaes.segment.overlay import draw_segmentation

    image = read_image(path)
    started = perf_counter()
    where: dict[str, Any] = {"box": hints.box, "points": hints.points, "not_points": hints.not_points}
    found = find(image, model=settings.model, weights=settings.weights, threads=threads, **where)
    seconds = perf_counter() - started
    if not found.mask.any():
        raise DvrkCmaesError(f"{path}: no instrument found; a box or a point on the instrument would help")
    written = {"mask": mask_path(out, frame), "overlay": overlay_path(out, frame)}
    if found.score is not None:
        written["score"] = out / "scores" / f"{frame}.png"
        write_image(written["score"], np.asarray(np.clip(found.score * 255 + 0.5, 0, 255), np.uint8))
    write_image(written["overlay"], draw_segmentation(image, found, frame, **where))
    write_image(written["mask"], found.mask)
    return Outcome(frame, found, written, seconds)


def _lines(outcome: Outcome) -> Iterator[Line]:
    """Say what was found in one image, and where it lies."""
    if outcome.found is None:
        yield Line(f"{outcome.frame}: failed: {outcome.problem}", STATUS_STYLES["failed"])
        return
    share = f"{100 * float(outcome.found.mask.mean()):.1f} % of the image"
    word = "a guess, " if outcome.status == "doubtful" else ""
    yield Line(
        f"{outcome.frame}: {word}confidence {outcome.found.confidence:.2f}, {share}, {outcome.seconds:.2f} s",
        STATUS_STYLES[outcome.status],
    )
    for note in outcome.found.notes:
        if note != "a guess":
            yield Line(f"  {note}")
    yield Line("  " + "   ".join(f"{kind}: {path}" for kind, path in outcome.written.items()))
