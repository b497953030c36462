"""boxes.csv: boxes and points of a session's frames, and the message for each unusable table."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from helpers.places import bundled_path

from dvrk_cmaes import InputError, read_session
from dvrk_cmaes.frames.keypoints import Hints, read_boxes
from dvrk_cmaes.runs.manifest import frame_stamps


def written(folder: Path, text: str) -> Path:
    path = folder / "boxes.csv"
    path.write_text(text)
    return path


def test_boxes_and_points_are_read(tmp_path: Path) -> None:
    found = read_boxes(written(tmp_path, "frame,x0,y0,x1,y1,u,v\na,1,2,30,40,,\nb,,,,,5,6.5\nc,1,2,3,4,2,3\nd,,,,,,\n"))
    assert found == {
        "a": Hints((1, 2, 30, 40)),
        "b": Hints(None, ((5, 6.5),)),
        "c": Hints((1, 2, 3, 4), ((2, 3),)),
        "d": Hints(),
    }
    assert read_boxes(written(tmp_path, "frame,u,v\na,1,2\n")) == {"a": Hints(None, ((1, 2),))}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("frame,x0,y0\n", "header: expected frame,x0,y0,x1,y1 or frame,u,v or both, got frame, x0, y0"),
        ("frame,u,v,w\n", "header: expected frame,x0,y0,x1,y1 or frame,u,v or both, got frame, u, v, w"),
        ("frame,u,v\na,1,x\n", "line 2: v: expected a finite number, got 'x'"),
        ("frame,u,v\na,1,\n", "line 2: v: expected a finite number, got ''"),
        ("frame,u,v\na,1,2\na,1,2\n", "line 3: frame: expected each frame once, got 'a' again"),
        ("frame,x0,y0,x1,y1\na,5,2,3,4\n", "line 2: expected a box with x0 < x1 and y0 < y1, got 5.0, 2.0, 3.0, 4.0"),
    ],
)
def test_wrong_table_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_boxes(path)
    assert str(caught.value).removeprefix(str(path)).lstrip(": ") == expected


def test_prompts_are_those_of_frames_without_mask(tmp_path: Path) -> None:
    session_folder = Path(shutil.copytree(bundled_path("demo"), tmp_path / "session"))
    for name in ("0001", "0002"):
        (session_folder / "masks" / f"{name}.png").unlink()
    written(session_folder, "frame,x0,y0,x1,y1\n0001,300,100,600,450\n")
    session = read_session(session_folder)
    before = {files.name: frame_stamps(files) for files in session.frames}
    other = Hints(None, ((1.0, 2.0),))
    prompts = {files.name: files.prompts for files in session.with_prompts(other).frames}
    assert prompts == {
        "0000": None,
        "0001": Hints((300, 100, 600, 450)),
        "0002": other,
        "0003": None,
        "0004": None,
    }
    after = {files.name: frame_stamps(files) for files in session.with_prompts(other).frames}
    assert [name for name in before if before[name] != after[name]] == ["0002"]
