"""Joint readings of one frame: unknown joints are left out, other units and unusable values are refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.readings import read_joints

from dvrk_cmaes import InputError

TABLE = """\
frame,yaw,pitch,insertion,roll,wrist_pitch,wrist_yaw,jaw
0026,0.59,-0.48,0.1697,0.39,-0.68,-0.36,1.34
0030,0.60,-0.47,0.1731,,-0.5,,1.2
"""


def table(folder: Path, text: str = TABLE) -> Path:
    path = folder / "joints.csv"
    path.write_text(text, encoding="utf-8")
    return path


def message(source: str | Path, frame: str | None = None, known: tuple[str, ...] = ()) -> str:
    with pytest.raises(InputError) as caught:
        read_joints(source, frame=frame, known=known)
    text = str(caught.value)
    assert "\n" not in text
    return text.removeprefix(f"{source}: ")


def test_blank_cell_and_missing_column_are_unknown(tmp_path: Path) -> None:
    readings = read_joints(str(table(tmp_path)), frame="0030")
    assert set(readings) == {"yaw", "pitch", "insertion", "wrist_pitch", "jaw"}
    assert read_joints(table(tmp_path, "frame\n7\n"), frame="7") == {}


def test_byte_order_mark_blank_lines_and_times_are_accepted(tmp_path: Path) -> None:
    text = "\ufeffframe, time, jaw\r\n\r\na b, 1755000000.25, 0.5\r\n,,\r\n"
    assert read_joints(table(tmp_path, text), frame="a b") == {"jaw": 0.5}


def test_existing_path_with_equals_sign_is_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "jaw=1.csv").write_text("frame,jaw\n1,0.25\n")
    assert read_joints("jaw=1.csv") == {"jaw": 0.25}
    assert message(Path("jaw=2.csv")).startswith("no such file; expected joint readings")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "wrist_pich=0.1",
            "joints: unknown joint 'wrist_pich'; expected one of "
            "wrist_pitch, wrist_yaw, pitch, insertion, jaw, yaw, roll",
        ),
        ("=0.1", "joints: unknown joint ''; expected one of wrist_pitch, wrist_yaw, jaw, yaw, pitch, insertion, roll"),
        ("jaw=0.1,", "joints: expected name=value,name=value, got ''"),
        ("jaw=0.1,0.2", "joints: expected name=value,name=value, got '0.2'"),
        ("jaw=0.1,jaw=0.1", "joints: jaw: expected one reading, got two"),
        ("jaw=", "joints: jaw: expected a finite number in rad, got ''"),
        ("jaw=wide", "joints: jaw: expected a finite number in rad, got 'wide'"),
        ("jaw=nan", "joints: jaw: expected a finite number in rad, got 'nan'"),
        ("insertion=inf", "joints: insertion: expected a finite number in m, got 'inf'"),
        ("jaw=76.9", "joints: jaw: expected radians (at most 2 pi), got 76.9: this looks like degrees"),
        ("roll=-6.29", "joints: roll: expected radians (at most 2 pi), got -6.29: this looks like degrees"),
        ("insertion=169.7", "joints: insertion: expected metres, got 169.7: this looks like millimetres"),
    ],
)
def test_unusable_reading_is_refused(text: str, expected: str) -> None:
    assert message(text) == expected


def test_reading_just_below_full_turn_is_accepted() -> None:
    assert read_joints("roll=6.28,insertion=-1") == {"roll": 6.28, "insertion": -1}


@pytest.mark.parametrize(
    ("text", "frame", "expected"),
    [
        (TABLE, None, "frame: expected one of its 2 frames (0026, 0030), got 'image' (--frame)"),
        (TABLE, "26", "frame: expected one of its 2 frames (0026, 0030), got '26' (--frame)"),
        (TABLE, "0031", "frame: expected one of its 2 frames (0030, 0026), got '0031' (--frame)"),
        (TABLE + "0026,,,,,,,\n", "0026", "line 4: frame: expected each frame once, got '0026' again"),
        (TABLE + ",1,,,,,,\n", "0026", "line 4: frame: expected a name, got a blank cell"),
        (TABLE + "0050,0.1\n", "0026", "line 4: expected 8 cells as in the header, got 2"),
        ("frame,jaw\n", "1", "expected a row for each frame, got a header only"),
        (
            "yaw;pitch\n1;2\n",
            "1",
            "header: expected a column frame or time and columns of joints, got yaw, pitch (rows that are only "
            "counted are read with --columns and the names of the columns)",
        ),
        ("frame,jaw,jaw\n1,2,3\n", "1", "header: expected each column once, got 'jaw' twice"),
        (
            "frame,jow\n1,2\n",
            "1",
            "header: unknown joint 'jow'; expected one of jaw, yaw, roll, wrist_yaw, insertion, wrist_pitch, pitch "
            "(--columns names columns, - one that is not read)",
        ),
        (
            'frame,jaw\n1,"' + "x" * 200_000,
            "1",
            "line 2: expected joint readings (joints.csv, or name=value,name=value), "
            "got no valid CSV (field larger than field limit (131072))",
        ),
        ("", "1", "expected joint readings (joints.csv, or name=value,name=value), got an empty file"),
    ],
)
def test_unusable_table_is_refused_with_line(tmp_path: Path, text: str, frame: str | None, expected: str) -> None:
    assert message(table(tmp_path, text), frame) == expected
