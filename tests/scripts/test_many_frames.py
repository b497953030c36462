"""scripts/measure/bench/many_frames.py: sessions and results of many frames, made of a few."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from helpers.batch_sessions import make_session
from helpers.places import SCRIPTS

from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.io.atomic import write_json


@pytest.fixture(autouse=True)
def scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(SCRIPTS), *sys.path])


def test_frames_are_repeated_in_their_order_with_readings(tmp_path: Path) -> None:
    from measure.bench.many_frames import repeated_session

    source = make_session(tmp_path / "source", ["a", "b", "c"])
    session = read_session(repeated_session(source, tmp_path / "many", 5, ["a", "c"]))
    own = {files.name: files.readings for files in read_session(source).frames}
    assert [files.name for files in session.frames] == ["00000", "00001", "00002", "00003", "00004"]
    assert [files.readings for files in session.frames] == [own[name] for name in "acaca"]


def test_small_masks_are_read_with_a_scaled_camera(tmp_path: Path) -> None:
    from measure.bench.many_frames import small_session

    source = make_session(tmp_path / "source", ["a"])
    whole, small = (read_session(folder) for folder in (source, small_session(source, tmp_path / "small", 2)))
    first, half = (read_frame(session.frames[0], session.camera) for session in (whole, small))
    assert (half.camera.width, half.camera.fx) == (first.camera.width / 2, pytest.approx(first.camera.fx / 2))
    assert half.mask.sum() == pytest.approx(first.mask.sum() / 4, rel=0.05)


def test_results_are_renamed_and_keep_their_drawings(tmp_path: Path) -> None:
    from measure.bench.many_frames import repeated_results

    for name in ("a", "b"):
        write_json(tmp_path / "source" / "frames" / f"{name}.json", {"frame": name, "of": name})
        write_json(tmp_path / "source" / "layers" / f"{name}.json", {"layers of": name})
    out = repeated_results(tmp_path / "source", tmp_path / "many", 3)
    documents = [json.loads(path.read_text()) for path in sorted((out / "frames").iterdir())]
    assert documents == [{"frame": f"{k:05d}", "of": "aba"[k]} for k in range(3)]
    assert json.loads((out / "layers" / "00002.json").read_text()) == {"layers of": "a"}
