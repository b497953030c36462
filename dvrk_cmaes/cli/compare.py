"""``dvrk-cmaes compare``: differences between sets of poses of the same frames, by frame and in sum."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from dvrk_cmaes.cli.options import OUTPUT, Flag, UrdfOptions, whole
from dvrk_cmaes.cli.terminal import Line, answer, table_lines
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import counted, listed

if TYPE_CHECKING:
    from dvrk_cmaes.evaluate.comparison import Comparison
    from dvrk_cmaes.evaluate.label_errors import LabelErrors, Labels

_TABLE = "compare.csv"


def compare(
    *results: Path,
    frames: Annotated[int, whole(0)] = 20,
    labels: Path | None = None,
    points: Path | None = None,
    instrument: UrdfOptions = UrdfOptions(),
    out: Annotated[Path | None, Parameter(group=OUTPUT)] = None,
    json: Annotated[Flag, Parameter(group=OUTPUT)] = False,
) -> int:
    """Compare two or more sets of poses of the same frames, by frame and in sum, without estimating again.

    The first set is the reference, or the truth if one of the sets is it. Examples: before and after a change of
    settings, solved alone and calibrated, another program's results, results and their truth.

    Example:

    ```
    dvrk-cmaes compare before after --out differences
    ```

    ```
    dvrk-cmaes compare session/golden.json results
    ```

    ```
    dvrk-cmaes compare session/tracks --labels session
    ```

    Parameters
    ----------
    results
        Folders of results, of this program or of any other that writes camera_from_root and joints; folders of followed
        recordings; published.csv; golden.json, or a session folder that has one.
    frames
        Number of frames in the printed table, the largest differences first; 0 for all.
    labels
        Session folder with markers.csv: labelled points, and how far from them, in pixels of the left or only camera,
        each set puts them. One set is enough then.
    points
        Where the labels lie on the instrument: JSON of link and position_m (metres) by name of the label. By default
        the bundled table that has most of them; that of SurgPose's labels is not verified. Others are left out.
    instrument
        The instrument, for the tips of sets that do not state them.
    out
        Folder for compare.csv, a row for each frame of each set, and compare.html, a page with plots and the overlays
        that differ most.
    json
        Print only the comparison, as JSON, on stdout.
    """
    from dvrk_cmaes.evaluate.compared_set import read_compared_set
    from dvrk_cmaes.evaluate.comparison import compare_sets
    from dvrk_cmaes.evaluate.label_errors import label_errors, read_labels
    from dvrk_cmaes.io.csv_file import csv_text
    from dvrk_cmaes.io.json_file import write_text
    from dvrk_cmaes.io.output import LONG, check_files, output
    from dvrk_cmaes.report.compare_page import PAGE, write_compare_page
    from dvrk_cmaes.results.folder import check_writable

    if out is not None:
        check_writable(out)
        check_files(out, "compare", (_TABLE, PAGE))
    if points is not None and labels is None:
        raise InputError("--points: expected --labels SESSION with it, got none")
    if len(results) < (2 if labels is None else 1):
        least = "two sets of poses to compare" if labels is None else "one set of poses to compare with the labels"
        raise InputError(f"RESULTS: expected at least {least}, got {len(results)}")
    loaded = instrument.load().instrument
    sets = [read_compared_set(path) for path in results]
    found_labels = None if labels is None else read_labels(labels, points)
    errors = [] if found_labels is None else [label_errors(each, found_labels, loaded) for each in sets]
    by_label = {} if found_labels is None else {"labels": found_labels.to_dict(errors)}
    label_lines = [] if found_labels is None else list(_label_lines(found_labels, errors))
    if len(sets) == 1:
        if out is not None:
            raise InputError("--out: expected at least two sets of poses, got one")
        answer(by_label, label_lines, json=json)
        return 0
    found = compare_sets(sets, loaded)
    written = []
    if out is not None:
        with output(out, "compare", wait=LONG):
            table = found.frames_table(found.frames)
            write_text(out / _TABLE, csv_text(table.head, table.rows))
            written += [out / _TABLE, write_compare_page(out, found)]
    tables = label_lines, table_lines(found.sets_table()), _sums(found), _frames(found, frames)
    lines = chain(*tables, (Line(f"written: {path}") for path in written))
    answer({**found.to_dict(), **by_label}, lines, json=json)
    return 0


def _label_lines(labels: Labels, errors: Sequence[LabelErrors]) -> Iterator[Line]:
    """Yield how far from the labels each set puts them: all together, and each by itself."""
    yield Line(f"labels: {labels.path}, their points by {labels.table_path}")
    yield Line(f"  used: {', '.join(labels.used)}")
    if labels.left_out:
        yield Line(f"  left out, for the table has no point of them: {', '.join(labels.left_out)}", "yellow")
    if labels.table_path.name == "surgpose.json":
        yield Line(
            "  it is not verified which points SurgPose's labels mean; --points FILE replaces the table", "yellow"
        )
    for of_set in errors:
        yield from table_lines(of_set.table())
        if of_set.without:
            yield Line(f"  labels in frames without a pose: {len(of_set.without)} frames", "yellow")


def _sums(comparison: Comparison) -> Iterator[Line]:
    """Yield the summary of each set's differences from the reference."""
    reference = comparison.labels[comparison.reference]
    for k in comparison.others:
        found = comparison.differences[k]
        yield from table_lines(comparison.sums_table(k))
        twins = sorted(frame for frame, difference in found.items() if difference.is_twin)
        if twins:
            yield Line(f"  mirror twin of {reference}: {counted(len(twins), 'frame')} ({listed(twins)})", "yellow")
        within = comparison.within_90(k)
        if within is not None:
            yield Line(f"  tips within the stated 90 % distance of the truth: {within[0]} of {within[1]} frames")
        within_std = comparison.within_std(k)
        if within_std is not None:
            once, twice, of = within_std
            shares = f"{once / of:.0%} of {of} frames, within twice of it {twice / of:.0%}"
            yield Line(f"  tips within their stated standard deviation of the truth: {shares} (expected: 65 %, 95 %)")
        if own := comparison.sets[k].own_names:
            name, before = next(iter(own.items()))
            yield Line(f"  paired by their numbers: {len(own)} frames, such as {before} with {name} of {reference}")
        missing = [name for name in comparison.frames if name in comparison.sets[comparison.reference].frames]
        missing = [name for name in missing if name not in found]
        if missing:
            names = f"{counted(len(missing), 'frame')} ({listed(missing)})"
            yield Line(f"  not compared, without a pose in one of the two: {names}", "yellow")


def _frames(comparison: Comparison, most: int) -> Iterator[Line]:
    """Yield the rows of the frames, the largest difference first; ``most`` of them, or all for 0."""
    chosen = comparison.by_size[: most or None]
    yield from table_lines(comparison.frames_table(chosen))
    if len(chosen) < len(comparison.by_size):
        yield Line(f"and {len(comparison.by_size) - len(chosen)} frames that differ less (--frames 0 shows all)")
