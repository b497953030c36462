"""``dvrk-cmaes golden record`` and ``golden check``: record poses of a lab's own frames, and compare later ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Group, Parameter

from dvrk_cmaes.cli.options import (
    OUTPUT,
    Flag,
    SessionOptions,
)
from dvrk_cmaes.cli.session_tools import open_session
from dvrk_cmaes.cli.terminal import DOUBTFUL, FAILED, STATUS_STYLES, Line, answer, table_lines, tracked, warn
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.evaluate import Tolerance

if TYPE_CHECKING:
    from dvrk_cmaes.evaluate.pose_check import PoseCheck
    from dvrk_cmaes.frames.truth import FrameTruth
    from dvrk_cmaes.instrument import Instrument
    from dvrk_cmaes.results.result import Result

TOLERANCE = Group.create_ordered("Tolerance")

golden = App(name="golden", help="Record the poses of a session's frames, and compare later estimates with them.")


@golden.command
def record(
    session: Path,
    /,
    *,
    golden: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    overwrite: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    allow_doubtful: Annotated[Flag, Parameter(group=OUTPUT)] = False,
    given: SessionOptions = SessionOptions(),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Estimate all frames of a session and record their poses in its golden.json.

    Inspect the overlays of the poses first (`estimate` and `batch` write them): the poses recorded are those estimated,
    not the true ones. Exit codes: 0 all frames recorded, 1 no frame recorded, 2 wrong usage or input, 3 some frames
    left out.

    Example:

    ```
    dvrk-cmaes golden record session
    ```

    Parameters
    ----------
    session
        Session folder: camera.yaml, joints.csv, masks.
    golden
        File to write; golden.json in the session folder by default.
    overwrite
        Replace the file if it exists.
    allow_doubtful
        Record the poses of doubtful frames as well.
    given
        The arm, the camera, the instrument and the settings.
    json
        Print only a summary, as JSON, on stdout: the frames recorded and those left out.
    """
    from dvrk_cmaes.frames.truth import FrameTruth, SessionTruth, write_golden
    from dvrk_cmaes.geometry import apply
    from dvrk_cmaes.results.folder import check_writable
    from dvrk_cmaes.runs.frame import estimated

    path = session / "golden.json" if golden is None else golden
    if path.exists() and not overwrite:
        raise InputError(f"{path}: expected no file yet, got one; --overwrite replaces it")
    check_writable(path.parent)
    (arm,) = open_session(session, given, single=True).values()
    frames, model = arm.session.frames, arm.body.instrument
    kept: dict[str, FrameTruth] = {}
    left_out: dict[str, str] = {}
    for result in (estimated(arm, files).result for files in tracked(frames, "Estimating")):
        if result.camera_from_root is None or (result.status != "ok" and not allow_doubtful):
            left_out[result.frame] = f"{result.status}: {'; '.join(result.reasons)}"
            continue
        ends = model.ends([result.joints[name] for name in model.joint_names])
        tips = apply(result.camera_from_root, ends)
        kept[result.frame] = FrameTruth(result.camera_from_root, result.joints, tips)
    if kept:
        write_golden(path, SessionTruth(kept))
    for frame, reason in left_out.items():
        warn(f"left out {frame}: {reason}")
    document = {"kept": list(kept), "left_out": left_out, "written": str(path) if kept else None}
    written = f"written: {path}" if kept else "nothing to keep, nothing written"
    answer(document, [Line(f"kept {len(kept)} of {len(frames)} frames"), Line(written)], json=json)
    return (DOUBTFUL if left_out else 0) if kept else FAILED


@golden.command
def check(
    session: Path,
    /,
    *,
    golden: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    tolerance: Annotated[Tolerance, Parameter(name="*", group=TOLERANCE)] = Tolerance(),
    modulo_twin: Annotated[Flag, Parameter(group=TOLERANCE)] = False,
    given: SessionOptions = SessionOptions(),
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Estimate a session's frames again and compare them with its golden poses.

    Exit codes: 0 all frames within tolerance, 1 a frame is not (the table marks the errors), 2 wrong usage or input.

    Example:

    ```
    dvrk-cmaes golden check session --tip-mm 1
    ```

    Parameters
    ----------
    session
        Session folder: camera.yaml, joints.csv, masks.
    golden
        File of golden poses; golden.json in the session folder by default.
    tolerance
        Largest differences.
    modulo_twin
        Accept the mirror twin of the golden pose as well: rolled by half a turn, with wrist pitch and yaw negated.
    given
        The arm, the camera, the instrument and the settings.
    json
        Print only the comparison, as JSON, on stdout.
    """
    from dvrk_cmaes.frames.paired_names import named_as
    from dvrk_cmaes.frames.truth import read_golden
    from dvrk_cmaes.io.short_text import listed
    from dvrk_cmaes.runs.frame import estimated

    for name, value in asdict(tolerance).items():
        if not value >= 0:
            raise InputError(f"--{name.replace('_', '-')}: expected a number of at least 0, got {value:g}")
    path = session / "golden.json" if golden is None else golden
    (arm,) = open_session(session, given, single=True).values()
    kept = named_as([files.name for files in arm.session.frames], read_golden(path).frames)
    if not kept:
        raise InputError(f"{path}: frames: expected golden poses, got none")
    there = {files.name for files in arm.session.frames}
    if gone := [name for name in kept if name not in there]:
        raise InputError(f"{path}: frames: expected frames of {arm.session.folder}, got {listed(gone)} too")
    frames = [files for files in arm.session.frames if files.name in kept]
    results = (estimated(arm, files).result for files in tracked(frames, "Estimating"))
    not_checked = [files.name for files in arm.session.frames if files.name not in kept]
    more, instrument = {"not_checked": not_checked}, arm.body.instrument
    right = answer_checks(results, kept, instrument, tolerance, more, modulo_twin=modulo_twin, json=json)
    return 0 if right else FAILED


def answer_checks(
    results: Iterable[Result],
    golden: Mapping[str, FrameTruth],
    instrument: Instrument,
    tolerance: Tolerance,
    more: Mapping[str, Any],
    *,
    modulo_twin: bool = False,
    json: bool,
) -> bool:
    """Compare results with golden poses by frame, as `check_pose` does; returns whether all are within tolerance.

    The comparisons are printed as JSON with ``more`` fields, or as a table of errors with all values of large ones.
    """
    from dvrk_cmaes.evaluate.pose_check import check_pose

    compare = partial(check_pose, instrument=instrument, tolerance=tolerance, modulo_twin=modulo_twin)
    checks = [(result, compare(result, golden[result.frame])) for result in results]
    right, frames = all(check.right for _, check in checks), [_document(*frame) for frame in checks]
    answer(
        {"right": right, "tolerance": asdict(tolerance), "frames": frames, **more}, _lines(checks, tolerance), json=json
    )
    return right


def _lines(checks: Sequence[tuple[Result, PoseCheck]], tolerance: Tolerance) -> Iterator[Line]:
    """Yield a table of errors, with all values of the frames that are not right."""
    from dvrk_cmaes.evaluate.pose_check import table
    from dvrk_cmaes.io.csv_file import Table, fixed

    quantities = list(dict.fromkeys(row.measured.quantity for _, check in checks for row in check.rows))
    rows = []
    for result, check in checks:
        cells = {row.measured.quantity: row.measured for row in check.rows}
        shown = [f"{e.error:.2f}{'!' * e.exceeds}" if (e := cells.get(name)) else "-" for name in quantities]
        error = result.expected_error
        stated = None if error is None or not error.determined else error.tip_90_mm
        rows.append((result.frame, result.status, fixed(stated, 1), *shown))
    yield Line("Errors: root and tip in mm, else deg (! is off); stated: tips within, mm (90 %)")
    yield from table_lines(Table(("frame", "status", "stated", *quantities), rows))
    for result, check in checks:
        if not check.right:
            yield Line(f"{result.frame}: not as the golden pose", STATUS_STYLES["failed"])
            yield from (Line(f"  {text}") for text in table(check))
    right = sum(check.right for _, check in checks)
    most = asdict(tolerance).items()
    limits = ", ".join(f"{name.rsplit('_', 1)[0].replace('_', '/')} {value:g}" for name, value in most)
    yield Line(f"{right} of {len(checks)} frames within tolerance (at most: {limits})")


def _document(result: Result, check: PoseCheck) -> dict[str, Any]:
    """Return a comparison as plain values; keys of errors have the unit: ``root_mm``, ``wrist_pitch_deg`` and so on."""
    from dvrk_cmaes.io.encode import encoded_fields

    return {
        **encoded_fields(result, "frame", "status", "reasons", "seconds"),
        "right": check.right,
        "is_twin": check.is_twin,
        "errors": {f"{measured.quantity}_{measured.unit}": measured.error for measured, _, _ in check.rows},
        "off": [measured.quantity for measured, _, _ in check.rows if measured.exceeds],
    }
