"""All readings of a session on one clock."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline

from dvrk_cmaes import InputError, Lag, ReadingSeries
from dvrk_cmaes.joints.interpolation import NANOSECONDS
from dvrk_cmaes.joints.reading import read_joint_file


def series_of(folder: Path, text: str, images: dict[str, int | None]) -> ReadingSeries | None:
    path = folder / "joints.csv"
    path.write_text(text)
    return ReadingSeries.of_files([read_joint_file(path)], images)


def test_rows_are_numbered_by_the_numbers_of_their_frames(tmp_path: Path) -> None:
    text = "frame,yaw,jaw\nf0010,0.1,1\nf0011,0.2,\nf0013,0.5,3\n"
    series = series_of(tmp_path, text, {"f0011": None, "f0013": None, "other": None})
    assert series is not None
    assert (series.unit, series.interval, series.frames) == ("frames", 1.0, {"f0011": 11.0, "f0013": 13.0})
    found = series.at(("yaw", "jaw", "roll"), np.array([11.0, 12.0, 9.0]))
    np.testing.assert_allclose(found[:, 0], [0.2, 0.35, np.nan])
    np.testing.assert_allclose(found[:, 1], [1 + 2 / 3, 1 + 4 / 3, np.nan])
    assert np.isnan(found[:, 2]).all()


def test_names_without_increasing_numbers_are_counted(tmp_path: Path) -> None:
    series = series_of(tmp_path, "frame,yaw\nb,0.1\na,0.2\nc,0.4\n", {"a": None, "c": None})
    assert series is not None
    assert series.frames == {"a": 1.0, "c": 2.0}


def test_rows_with_times_give_a_clock_in_seconds(tmp_path: Path) -> None:
    rows = "".join(f"{k:04d},{100 + k / 30:.6f},{k / 10}\n" for k in range(10))
    series = series_of(tmp_path, f"frame,time,yaw\n{rows}", {"0003": None, "0006": None})
    assert series is not None
    assert series.unit == "s"
    assert series.interval == pytest.approx(1 / 30, abs=1e-6)
    np.testing.assert_allclose(list(series.frames.values()), [0.0, 0.1], atol=1e-6)
    found = series.at(("yaw",), np.array(list(series.frames.values())) - 0.05)
    np.testing.assert_allclose(found[:, 0], [0.15, 0.45], atol=1e-4)


def test_images_have_times_of_their_own(tmp_path: Path) -> None:
    rows = "".join(f"{k / 100:.2f},{k / 100}\n" for k in range(100))
    images = {"a": round(0.205 * NANOSECONDS), "b": round(0.305 * NANOSECONDS)}
    series = series_of(tmp_path, f"time,yaw\n{rows}", dict(images))
    assert series is not None
    assert (series.unit, series.interval) == ("s", pytest.approx(0.1))
    np.testing.assert_allclose(series.at(("yaw",), np.array([0.0, 0.1]))[:, 0], [0.205, 0.305])


def test_rows_without_frames_or_times_give_no_series(tmp_path: Path) -> None:
    assert series_of(tmp_path, "time,yaw\n0.1,0.1\n0.2,0.1\n", {"a": None, "b": None}) is None
    assert series_of(tmp_path, "frame,yaw\na,0.1\n", {"a": None}) is None


def test_long_gap_in_the_readings_is_not_interpolated() -> None:
    clock = np.array([0.0, 1.0, 2.0, 3.0, 9.0, 10.0])
    series = ReadingSeries("frames", {"yaw": clock}, {"yaw": clock / 10}, {}, 1.0)
    found = series.at(("yaw",), np.array([2.5, 3.0, 5.0, 9.0, 9.5]))[:, 0]
    np.testing.assert_allclose(found, [0.25, 0.3, np.nan, 0.9, 0.95])
    in_seconds = ReadingSeries("s", {"yaw": clock / 100}, {"yaw": clock / 10}, {}, 0.01)
    np.testing.assert_allclose(in_seconds.at(("yaw",), np.array([0.05]))[:, 0], [0.5])


def test_readings_of_a_frame_are_those_of_its_time_less_the_lag(tmp_path: Path) -> None:
    rows = "".join(f"{k:04d},{100 + k / 10:.1f},{k / 10}\n" for k in range(10))
    series = series_of(tmp_path, f"frame,time,yaw\n{rows}", {"0003": None, "0006": None})
    assert series is not None
    assert series.origin == pytest.approx(100.3)
    assert series.of_frame("0006", Lag(None, seconds=0.25)) == {"yaw": pytest.approx(0.35)}
    assert series.of_frame("0003", Lag(None, seconds=0.5)) == {}
    with pytest.raises(InputError, match="expected a lag in seconds"):
        series.of_frame("0003", Lag(2.0))


@pytest.mark.parametrize("count", [2, 3, 30])
def test_smoothed_readings_are_those_of_cubic_spline(count: int) -> None:
    rows, values = np.arange(float(count)), np.random.default_rng(2).standard_normal(count)
    series = ReadingSeries("frames", {"yaw": rows}, {"yaw": values}, {"0000": 0.0}, 1.0)
    beyond = 2 * values[0] - values[1], 2 * values[-1] - values[-2]
    spline = BSpline(np.arange(-3.0, count + 3.0), np.concatenate([beyond[:1], values, beyond[1:]]), 3)
    times = np.concatenate([rows, np.linspace(0, count - 1, 50)])
    np.testing.assert_allclose(series.at(("yaw",), times, smoothed=True)[:, 0], spline(times), atol=1e-12)
