"""The HTML page of a session's results, OUT/report.html, which needs no network.

The page contains the overlays of the most doubtful frames at full size, up to a limit, and links to the others
(``overlays/``). It can be read and printed without scripts; with scripts, frames can be sorted, filtered and browsed
with the keyboard, and the layers of the drawings shown one by one. The same results give the same bytes: the page does
not depend on the time or the machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from urllib.parse import quote

from dvrk_cmaes.calibration.document import SessionCalibration
from dvrk_cmaes.report.page_calibration import calibration_view, left_out_views
from dvrk_cmaes.report.page_frames import STATUSES, FrameCard, LeaveOneOut, doubt_key
from dvrk_cmaes.report.page_layers import EMBEDDED, embedded_layers, embedded_picture, size_of_layers
from dvrk_cmaes.report.page_scene import scene_of
from dvrk_cmaes.report.page_session import (
    FrameBases,
    Run,
    common_warnings,
    counted_reasons,
    joint_summaries,
    provenances,
    session_figures,
)
from dvrk_cmaes.report.page_template import render_template, write_rendered
from dvrk_cmaes.report.page_thumbnails import thumbnail
from dvrk_cmaes.report.plots.panels import joint_plot, rcm_plot
from dvrk_cmaes.report.plots.tips import speed_plot, tips_plot
from dvrk_cmaes.results.folder import SESSION, ResultsFolder, read_results, result_paths
from dvrk_cmaes.results.paths import layers_path, left_out_path, overlay_path
from dvrk_cmaes.results.result import Result

_THREADS = 2


def write_page(out: Path, folder: ResultsFolder | None = None) -> Path:
    """Write OUT/report.html for the results in OUT, and return its path.

    The inputs are ``OUT/frames/*.json``, ``OUT/overlays/*.jpg``, and if they exist ``layers/*.json``, ``summary.json``,
    ``session.json`` and ``overlays_left_out/*.jpg``.

    Parameters
    ----------
    out
        The folder OUT.
    folder
        The results in OUT, if they were read before; by default they are read.

    Raises
    ------
    InputError
        No results, or one that cannot be read, as in ``read_results``; a folder that cannot be written to.
    """
    return write_rendered(out / "report.html", render_page(read_results(out) if folder is None else folder))


def render_page(folder: ResultsFolder) -> str:
    """Render the HTML page of a results folder."""
    results = list(folder.frames.values())
    run = Run.of(folder.summary)
    calibration = None
    if folder.session is not None:
        calibration = SessionCalibration.from_dict(folder.session, where=str(folder.folder / SESSION))
    left = {} if calibration is None else calibration.left_out
    solved = [result for result in results if result.frame not in left]  # the session's figures are of these
    base = FrameBases.of(solved)
    left_out = {} if calibration is None else left_out_views(folder, calibration, _documents(folder))
    views = _views(folder, results, base, left_out)
    return render_template(
        "page.html",
        scripts=("tiles.js", "page.js", "layers.js", "scene.js"),
        rules=sorted({view.thumbnail.crop.style for view in views if view.thumbnail and view.thumbnail.crop}),
        results=results,
        times=any(result.time is not None for result in results),
        run=run,
        instruments=sorted({result.instrument for result in results} - {""}),
        statuses=STATUSES,
        counts={status: sum(result.status == status for result in results) for status in STATUSES},
        together=sum(result.source == "session" for result in results),
        figures=list(session_figures(solved, base, run)),
        joints=list(joint_summaries(solved)),
        reasons=counted_reasons([result.reasons for result in results]),
        shared_warnings=common_warnings(results),
        joint_plot=joint_plot(results),
        tips_plot=tips_plot(results),
        speed_plot=speed_plot(results),
        scene=scene_of(results, base),
        rcm_plot=None if base is None else rcm_plot(results, base),
        base=base,
        frames=views,
        calibration=None if calibration is None else calibration_view(folder, calibration, left_out),
        provenances=provenances(results),
    )


def _documents(folder: ResultsFolder) -> dict[str, str]:
    """Return the paths of the result files, relative to the folder, by file name without suffix.

    A frame's name is read from inside its result; only if it equals the name of a file are the frame's files known.
    """
    return {path.stem: path.relative_to(folder.folder).as_posix() for path in result_paths(folder.folder)}


def _views(
    folder: ResultsFolder, results: Sequence[Result], base: FrameBases | None, left_out: Mapping[str, LeaveOneOut]
) -> list[FrameCard]:
    """Make the entries of all frames, the most doubtful first."""
    documents = _documents(folder)
    overlays = [overlay_path(folder.folder, name) if name in documents else None for name in folder.frames]
    with ThreadPoolExecutor(_THREADS) as pool:
        thumbnails = list(pool.map(thumbnail, overlays, results))
    away = {} if base is None else dict(zip(base.frames, base.points - base.centre, strict=True))
    views = [
        FrameCard(
            result,
            place,
            small,
            None if small is None or overlay is None else _address(f"overlays/{overlay.name}"),
            _address(documents[name]) if name in documents else None,
            away.get(name),
            left_out.get(name),
        )
        for place, (name, result, overlay, small) in enumerate(
            zip(folder.frames, results, overlays, thumbnails, strict=True)
        )
    ]
    views.sort(key=lambda view: (doubt_key(view.result), view.place))
    return _with_full_pictures(views, folder.folder)


def _with_full_pictures(cards: Sequence[FrameCard], folder: Path) -> list[FrameCard]:
    """Return entries of frames with their full pictures, in their order, until these reach the limit of size."""
    complete: list[FrameCard] = []
    size = 0
    with ThreadPoolExecutor(_THREADS) as pool:
        while size < EMBEDDED and len(complete) < len(cards):
            next_cards = cards[len(complete) : len(complete) + _THREADS]
            full = pool.map(partial(_with_full_picture, folder=folder), next_cards)
            for plain, card in zip(next_cards, full, strict=True):
                complete.append(card if size < EMBEDDED else plain)
                size += len(card.full or "") + size_of_layers(card.layers)
                size += 0 if card.left_out is None else len(card.left_out.full or "")
    return [*complete, *cards[len(complete) :]]


def _with_full_picture(card: FrameCard, folder: Path) -> FrameCard:
    """Return the entry of a frame that has files with overlay, layers and picture of its prediction within the page."""
    if card.document is None:
        return card
    name, left_out = card.result.frame, card.left_out
    if left_out is not None and left_out.picture:
        left_out = replace(left_out, full=embedded_picture(left_out_path(folder, name)))
    return replace(
        card,
        full=embedded_picture(overlay_path(folder, name)) if card.overlay else None,
        layers=embedded_layers(layers_path(folder, name)),
        left_out=left_out,
    )


def _address(path: str) -> str:
    return quote(path, errors="replace")
