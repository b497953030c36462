"""Measure what each tuned constant of the method does: answers on data with truth, with its value halved and doubled.

    python scripts/sensitivity.py pose evidence --frames SESSION... --write
    python scripts/sensitivity.py calibration track --recordings SESSION... --write
    python scripts/sensitivity.py segment --pictures SESSION... --drawn 4 --new --write
    python scripts/sensitivity.py --show                     # constants that change nothing on any data

Constants are the numbers that the modules of packages assign at their top level. The numbers of a tuple are changed
together; whole numbers stay whole. Each change is tried in a process of its own, with one thread. Frames are solved one
by one; recordings are followed with their own calibration by masks, and, with it, from image to image, and likewise by
images where there are any; in pictures masks are found as `estimate --image` does, before the background that the
session's images show, if they do. A change that ends the run, or makes it take eight times as long, is named by its
error.

--write puts the rows into scripts/measure/sensitivity.csv, which has the value of each constant, the changed one, and
figures with those of the unchanged run in brackets: of the images with a truth in view, those in the right place
(tips within 5 mm; of masks an IoU of .8), those that are ok (of masks: with a confidence above .8), and those ok and
more than 3 mm off (of masks: not right); the median error of the tips, or the mean of 1 - IoU; and seconds of processor
time. A row counts as long as its constant has that value.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import json
import multiprocessing
import os
import pickle
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, is_dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from measure.accuracy.errors import error_of
from measure.accuracy.fleet import TipErrors
from measure.cases import Case, Measurement
from measure.constants import Row, constants_in, measured, read_table, write_table
from measure.pictures import Picture, found_in, pictures_of
from measure.places import ROOT
from measure.tables import commit

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.results.track_files import TRACKS, read_tracks
from dvrk_cmaes.runs.backgrounds import learned_backgrounds
from dvrk_cmaes.runs.track_folder import track_folder
from dvrk_cmaes.runs.track_frames import TrackSettings
from dvrk_cmaes.segment.segmentation import SegmentSettings
from dvrk_cmaes.silhouette import Body
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.track.view_segmenter import EvidenceKind

RIGHT_MM: Final = 5.0
WRONG_MM: Final = 3.0
RIGHT_IOU: Final = 0.8
SURE: Final = 0.8
_DRAWN: Final = 4000  # first seed of drawn pictures
_CHANGE: Final = "DVRK_CMAES_SENSITIVITY_CHANGE"  # variable that tells a changed constant to processes
SLOWER: Final = 8


class Figures(NamedTuple):
    """Figures of a run: images in the right place, ok, ok and wrong; how far they are off; processor seconds."""

    right: int
    ok: int
    wrong: int
    off: float
    seconds: float


class Changed(NamedTuple):
    """A constant of a module and a changed value of it."""

    module: str
    name: str
    value: str
    changed: Any


def changes(packages: Sequence[str], factors: Sequence[float]) -> Iterator[Changed]:
    """Yield the changed values of all constants of packages whose numbers a factor changes."""
    root = ROOT / "dvrk_cmaes"
    folders = [root / package for package in packages]
    for path in sorted(path for one in folders for path in ([one] if one.is_file() else one.rglob("*.py"))):
        module = path.relative_to(root)
        loaded = importlib.import_module(
            ".".join(["dvrk_cmaes", *module.with_suffix("").parts]).removesuffix(".__init__")
        )
        for constant in constants_in(ast.parse(path.read_text(encoding="utf-8")).body):
            for name in constant.name.strip("()").split(", "):
                now = getattr(loaded, name)
                for factor in factors:
                    new = scaled(now, factor)
                    if repr(new) != repr(now):
                        yield Changed(module.as_posix(), constant.name, constant.value, (name, new))


def module_name(path: Path) -> str:
    """Return the name of the module at a path in dvrk_cmaes."""
    return ".".join(["dvrk_cmaes", *path.with_suffix("").parts]).removesuffix(".__init__")


def scaled(value: Any, factor: float) -> Any:
    """Return a value with its numbers multiplied; whole ones are rounded, and at least 1 if they were."""
    if isinstance(value, bool | str | bytes) or value is None:
        return value
    if isinstance(value, int):
        return max(round(value * factor), 1) if value > 0 else round(value * factor)
    if isinstance(value, float):
        return value * factor
    if isinstance(value, np.ndarray):
        return (value * factor).astype(value.dtype)
    if isinstance(value, dict):
        return {key: scaled(one, factor) for key, one in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*(scaled(one, factor) for one in value))
    if isinstance(value, list | tuple):
        return type(value)(scaled(one, factor) for one in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(
            value, **{one.name: scaled(getattr(value, one.name), factor) for one in fields(value) if one.init}
        )
    return value


def put(change: Changed) -> None:
    """Give a constant its changed value, in its module and in all that import it."""
    name, new = change.changed
    old = getattr(importlib.import_module(module_name(Path(change.module))), name)
    for loaded in [module for key, module in sys.modules.items() if key.startswith("dvrk_cmaes")]:
        if name in vars(loaded) and vars(loaded)[name] is old:
            setattr(loaded, name, new)


def solve_frames(cases: Sequence[Case], body: Body) -> Figures:
    """Solve frames one by one."""
    began, errors, ok = time.process_time(), [], []
    for case in cases:
        result = case.estimate(body, EstimateConfig(threads=1))
        error = error_of(body.instrument, result, case.truth)
        errors.append(1e3 if error is None or error.tip_mm is None else error.tip_mm)
        ok.append(result.status == "ok")
    return _figures(np.array(errors), np.array(ok), began)


def follow(folders: Sequence[Path], body: Body) -> Figures:
    """Follow recordings with their own calibration, and from image to image."""
    began, found = time.process_time(), []
    for folder in folders:
        golden = json.loads((folder / "golden.json").read_text(encoding="utf-8"))["frames"]
        session = read_session(folder)
        has_images = any(frame.has_image for frame in session.frames)
        kinds: list[tuple[EvidenceKind, bool]] = [("masks", False), ("masks", True)]
        kinds += [("images", False), ("images", True)] if has_images else []
        with tempfile.TemporaryDirectory() as out:
            settings = TrackSettings(EstimateConfig(threads=1), workers=1)
            for number, (kind, causal) in enumerate(kinds):
                chosen = replace(settings, causal=causal, evidence=kind)
                done = track_folder(session, Path(out) / str(number), body, chosen, video=False, page=False)
                settings = replace(settings, calibration=settings.calibration or done.calibration)
                found.append(TipErrors.of(read_tracks(Path(out) / str(number) / TRACKS), golden))
    each = TipErrors.pooled(found)
    return _figures(each.errors, each.ok, began)


class Shown(NamedTuple):
    """Pictures of a session, or drawn ones, and by the name of their view the images that may show its background."""

    pictures: Sequence[Picture]
    images: Mapping[str, Sequence[Path]] = MappingProxyType({})


def shown_in(folder: Path, instrument: str, most: int | None) -> Shown:
    """Read at most some pictures of a session of one eye, of the instrument that its session.toml names, or this."""
    named = read_session_toml(folder)
    own = None if named is None else named.tools[0].instrument
    found = [*pictures_of(folder.name, folder, own or instrument)]
    chosen = (
        found
        if most is None
        else [found[k] for k in np.unique(np.linspace(0, len(found) - 1, most).round().astype(int))]
    )
    session = read_session(folder)
    images = [files.image for files in session.frames if files.image is not None]
    prepare(own or instrument)  # once, and not in the process of each change
    return Shown(chosen, {session.rig.names[0]: images})


def find_masks(shown: Sequence[Shown]) -> Figures:
    """Find the instruments in pictures."""
    began, right, sure = time.process_time(), [], []
    for each in shown:
        settings = learned_backgrounds(SegmentSettings(), each.images)
        for picture in each.pictures:
            try:
                found = found_in(picture, prepare(picture.instrument), settings, EstimateConfig(threads=1)).segmentation
            except DvrkCmaesError:
                found = None
            right.append(0.0 if found is None else picture.shows(found.mask) or 0.0)
            sure.append(found is not None and found.confidence > SURE)
    wrong = [s and r < RIGHT_IOU for r, s in zip(right, sure, strict=True)]
    off, seconds = 1 - float(np.mean(right)), time.process_time() - began
    return Figures(sum(r >= RIGHT_IOU for r in right), sum(sure), sum(wrong), off, seconds)


def _figures(errors: Any, ok: Any, began: float) -> Figures:
    """Return the figures of errors, mm, and statuses (F,)."""
    counts = (int((errors < RIGHT_MM).sum()), int(ok.sum()), int((ok & (errors > WRONG_MM)).sum()))
    return Figures(*counts, float(np.median(errors)), time.process_time() - began)


class Data(NamedTuple):
    """What is solved, read once: frames with their truth, recordings, their instrument, and pictures."""

    cases: Sequence[Case]
    recordings: Sequence[Path]
    body: Body
    shown: Sequence[Shown] = ()

    def run(self) -> Figures:
        """Solve all of it."""
        if self.shown:
            return find_masks(self.shown)
        return solve_frames(self.cases, self.body) if self.cases else follow(self.recordings, self.body)


def _child(sent: Connection, data: Data, change: Changed | None) -> None:
    """Run with a changed constant, and send the figures or the error as a line."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        if change is not None:
            put(change)
            os.environ[_CHANGE] = pickle.dumps(tuple(change)).hex()
        sent.send(data.run())
    except BaseException as error:  # whatever a wrong constant brings about
        sent.send(f"{type(error).__name__}: {error}".splitlines()[0][:80])


def tried(data: Data, change: Changed | None, limit: float) -> Figures | str:
    """Run with a changed constant in a process of its own; returns the error's line if it fails or takes too long."""
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(send, data, change))
    process.start()
    send.close()
    try:
        return receive.recv() if receive.poll(limit) else f"took more than {SLOWER} times as long"
    except EOFError:
        return "the process died"
    finally:
        process.kill()
        process.join()


def main() -> int:
    """Try all changes, print a line for each that changes answers, and return the exit code."""
    options = _parser().parse_args()
    if options.show:
        return _show()
    folders = options.frames or options.recordings or options.pictures
    measurement = Measurement(folders, options.instrument, frames=options.most)
    shown = [shown_in(Path(p), options.instrument, options.most) for p in options.pictures]
    from measure.drawn_pictures import drawn_picture

    drawn = [*map(drawn_picture, range(_DRAWN, _DRAWN + options.drawn))]
    shown += [Shown([one for one in drawn if one is not None])] if drawn else []
    recordings = [Path(p) for p in options.recordings]
    data = Data(measurement.cases() if options.frames else (), recordings, measurement.body, shown)
    names = ", ".join([*(_named(Path(p)) for p in folders), *([f"{options.drawn} drawn"] if drawn else [])])
    before = tried(data, None, 3600)
    if isinstance(before, str):
        print(f"sensitivity.py: {before}", file=sys.stderr)
        return 1
    print(f"unchanged: {before}", flush=True)
    limit = max(60.0, 3 * SLOWER * before.seconds)
    known = measured(read_table()) if options.new else {}
    each = [one for one in changes(options.packages, options.factors) if one.value not in known.get(one[:2], ())]
    each = each[options.part - 1 :: options.parts]
    rows: list[Row] = []
    with ThreadPoolExecutor(options.workers) as pool:
        for change, found in zip(each, pool.map(lambda one: tried(data, one, limit), each), strict=True):
            rows.append(row_of(change, found, before, names))
            if isinstance(found, str) or found[:4] != before[:4]:
                print(f"{change.module} {change.name} {change.value} -> {change.changed[1]}: {found}", flush=True)
            if options.write:
                write_table(rows)  # all so far, if the run is ended
    return 0


def _named(folder: Path) -> str:
    """Return the name of a session's folder, and, if that is a part of a world, of the world."""
    return "/".join(folder.resolve().parts[-2:]) if (folder / "world.json").is_file() else folder.resolve().name


def row_of(change: Changed, found: Figures | str, before: Figures, data: str) -> Row:
    """Return the table's row of a changed constant."""
    figures = None if isinstance(found, str) else [*map(_both, found, before)]
    texts = ["", "", "", "", "", str(found)] if figures is None else [*figures, ""]
    changed = " = ".join([change.changed[0], str(change.changed[1]).replace("\n", " ")])
    return Row._make([change.module, change.name, change.value, changed, *texts, data, commit()])


def _both(new: float, old: float) -> str:
    """Return a figure and, in brackets, what it was."""
    return f"{round(new, 3):g} ({round(old, 3):g})"


def _show() -> int:
    """Print the constants whose changes change no answer in any row of the table."""
    rows = read_table()
    for (module, name), values in measured(rows).items():
        figures = [cell.strip(")").split(" (") for row in rows if row[:2] == (module, name) for cell in row[4:8]]
        if all(len(pair) == 2 and pair[0] == pair[1] for pair in figures):
            print(f"{module} {name} {' '.join(values)}")
    return 0


def _parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packages", nargs="*", metavar="PACKAGE", help="packages or files of dvrk_cmaes, such as pose")
    parser.add_argument("--frames", nargs="+", default=[], metavar="SESSION", help="sessions whose frames are solved")
    parser.add_argument("--recordings", nargs="+", default=[], metavar="SESSION", help="recordings that are followed")
    parser.add_argument(
        "--pictures", nargs="+", default=[], metavar="SESSION", help="sessions of images with true masks"
    )
    parser.add_argument("--drawn", type=int, default=0, metavar="N", help="pictures that are drawn (default: none)")
    parser.add_argument("--instrument", default="lnd", help="the instrument of these (default: %(default)s)")
    parser.add_argument("--most", type=int, metavar="N", help="at most N frames of each session")
    parser.add_argument("--factors", nargs="+", type=float, default=[0.5, 2.0], metavar="X", help="default: 0.5 2")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (default: %(default)s)")
    parser.add_argument("--parts", type=int, default=1, metavar="N", help="try every N-th change only")
    parser.add_argument("--part", type=int, default=1, metavar="K", help="which of these parts, from 1")
    parser.add_argument("--new", action="store_true", help="try constants only whose value has no row in the table")
    parser.add_argument("--write", action="store_true", help="put the rows into the table")
    parser.add_argument("--show", action="store_true", help="print the constants of the table that change nothing")
    return parser


if __name__ == "__mp_main__" and _CHANGE in os.environ:  # a process that a changed run started
    put(Changed(*pickle.loads(bytes.fromhex(os.environ[_CHANGE]))))
if __name__ == "__main__":
    sys.exit(main())
