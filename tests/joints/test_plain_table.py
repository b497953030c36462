"""Large tables of numbers, read by columns: the same readings as by rows, and only tables that are plain."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.joints import reading
from dvrk_cmaes.joints.csv_table import read_plain_table
from dvrk_cmaes.joints.names import accepted_names
from dvrk_cmaes.joints.reading import read_joint_file
from dvrk_cmaes.joints.series import ReadingSeries

NAMES = ("yaw", "insertion", "jaw")


def table(rows: int, *, blank: str = "", end: str = "\n", base: int = 1_700_000_000) -> str:
    """Give a table with times of six decimals, in which every third jaw is missing."""
    lines = [
        f"{base + k // 1000}.{k % 1000:03d}123,{0.1 + 1e-7 * k:.9f},{-1e-3 * (k % 7):g},{'0.5' if k % 3 else blank}"
        for k in range(rows)
    ]
    return end.join([",".join(("time", *NAMES)), *lines, ""])


def named(rows: int, *, key: str = "frame,time") -> str:
    """Give the same table with names of frames of unequal width, and with times or without."""
    head, *lines = table(rows).splitlines()
    kept = slice(0 if "time" in key else 1, None)
    body = [",".join((f"row{k}", *line.split(",")[kept])) for k, line in enumerate(lines)]
    return "\n".join([",".join(("frame", *head.split(",")[kept])), *body, ""])


@pytest.mark.parametrize("key", ["frame", "frame,time"])
def test_named_rows_are_those_of_the_reader_of_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, key: str) -> None:
    path, images = tmp_path / "joints.csv", dict.fromkeys(["row7", "row1500", "row2999"])
    path.write_text(named(3000, key=key))
    monkeypatch.setattr(reading, "LEAST", 10)
    columns = read_joint_file(path)
    assert not isinstance(columns.names, dict)
    monkeypatch.setattr(reading, "LEAST", 10**9)
    rows = read_joint_file(path)
    assert (columns.labels, dict(columns.names), columns.joints) == (rows.labels, rows.names, rows.joints)
    assert {"row30", "row3000", "row", "r\u00f6w1"} & {*columns.names} == {"row30"}
    np.testing.assert_array_equal(columns.times, rows.times)
    np.testing.assert_array_equal(columns.values, rows.values)
    series = [ReadingSeries.of_files([file], images) for file in (columns, rows)]
    assert series[0] is not None
    assert series[1] is not None
    assert (series[0].unit, series[0].frames) == (series[1].unit, series[1].frames)
    for joint, values in series[1].values.items():
        np.testing.assert_array_equal(series[0].values[joint], values)
        np.testing.assert_array_equal(series[0].times[joint], series[1].times[joint])


@pytest.mark.parametrize(("blank", "end"), [("", "\n"), ("nan", "\n"), ("", "\r\n"), ("NaN", "\n")])
def test_readings_are_those_of_the_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blank: str, end: str) -> None:
    path = tmp_path / "joints.csv"
    path.write_bytes(table(3000, blank=blank, end=end).encode())
    monkeypatch.setattr(reading, "LEAST", 10)
    columns = read_joint_file(path)
    monkeypatch.setattr(reading, "LEAST", 10**9)
    rows = read_joint_file(path)
    assert columns.joints == rows.joints
    np.testing.assert_array_equal(columns.times, rows.times)
    np.testing.assert_array_equal(columns.values, rows.values)
    for place in (0, 1, 2999):
        assert columns.readings(place) == rows.readings(place)
    by_name = {one.joints[0]: one for one in rows.timed}
    for one in columns.timed:
        np.testing.assert_array_equal(one.times, by_name[one.joints[0]].times)
        np.testing.assert_array_equal(one.values, by_name[one.joints[0]].values)


@pytest.mark.parametrize(
    "text",
    [
        table(20).replace("time", "name"),
        named(20).replace("row7", "row6"),
        named(20).replace("row7", ""),
        named(20).replace("row7", "a long name of more than 24 letters"),
        named(20).replace("0.5", "28.6", 1),
        table(20).replace("jaw", "jav"),
        table(20).replace("0.5", "half", 1),
        table(20).replace("0.5", "0.5.5", 1),
        table(20).replace("0.5", "0.5,1", 1),
        table(20).replace("1700000000.019123", "1700000000.001123"),
        table(20, base=1_700_000_000_000),
        "time,jaw\n" + "".join(f"{k},0.5\n" for k in range(20)),
    ],
)
def test_table_that_is_not_plain_is_left_to_the_reader_of_rows(text: str) -> None:
    assert read_plain_table("joints.csv", text.encode(), accepted_names()) is None


def test_reading_in_another_unit_is_refused_with_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "LEAST", 10)
    (tmp_path / "joints.csv").write_text(table(20).replace("0.5\n", "28.6\n", 1))
    with pytest.raises(InputError, match=r"joints\.csv: line 3: jaw: expected radians"):
        _ = read_joint_file(tmp_path / "joints.csv").timed


@pytest.mark.parametrize("text", [table, named])
def test_memory_is_within_three_times_the_file(tmp_path: Path, text: Callable[[int], str]) -> None:
    path = tmp_path / "joints.csv"
    path.write_text(text(100_000))
    tracemalloc.start()
    try:
        assert len(read_joint_file(path).timed[0].times) == 100_000
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 3 * path.stat().st_size + 60_000_000  # a part that is read at once takes 60 MB
