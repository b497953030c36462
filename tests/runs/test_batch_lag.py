"""``dvrk-cmaes batch --lag``: readings of the moment that an image shows, by a given or a calibrated lag."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batch_sessions import QUICK, make_session
from helpers.commands import Ran, run_command
from helpers.files import write_json
from helpers.page_calibrations import calibration, solved

from dvrk_cmaes import Body, Lag, SessionCalibration, read_session

pytestmark = pytest.mark.usefixtures("tasks_here", "estimates_shared")

NAMES = [f"{k:04d}" for k in range(4)]

Command = Callable[..., Ran]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Command:
    """Run a batch of a session of four frames with quick settings."""
    monkeypatch.chdir(tmp_path)
    make_session(tmp_path / "session", NAMES)
    (tmp_path / "quick.toml").write_text(QUICK)
    return lambda *options: run_command(
        capsys, "batch", "session", "--config", "quick.toml", "--workers", 1, "--out", "out", *options
    )


def result(name: str) -> dict[str, object]:
    found: dict[str, object] = json.loads((Path("out") / "frames" / f"{name}.json").read_text())
    return found


def test_given_lag_gives_frames_earlier_readings(command: Command) -> None:
    rows = read_session("session").frames
    assert command("--lag", "1frame").code in (0, 3)
    assert result("0002")["readings"] == pytest.approx(rows[1].readings)
    assert "readings of 1 frames before the image" in str(result("0002")["warnings"])
    assert result("0000")["readings"] == {}
    assert "no readings of 1 frames before the image" in str(result("0000")["warnings"])


def test_no_lag_is_none_also_of_readings_without_times(command: Command) -> None:
    assert command("--lag", "0").code in (0, 3)
    assert result("0002")["readings"] == pytest.approx(read_session("session").frames[2].readings)
    assert not [text for text in result("0002")["warnings"] if "before the image" in text]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (
            ("--lag", "soon"),
            "--lag: expected a number of seconds such as 0.13, or of frames such as 4frames, got 'soon'",
        ),
        (("--lag", "0.1"), "lag: expected a lag in frames, such as 4frames, since the images have no times, got 0.1 s"),
        (
            ("--lag", "auto"),
            "--lag: expected a number of seconds such as 0.13, or of frames such as 4frames, got 'auto'",
        ),
    ],
)
def test_wrong_lag_is_refused(command: Command, options: tuple[str, ...], expected: str) -> None:
    done = command(*options)
    assert (done.code, done.err) == (2, f"dvrk-cmaes: {expected}\n")
    assert not Path("out").exists()


def test_lag_of_the_calibration_is_taken_out(tmp_path: Path) -> None:
    session = read_session(make_session(tmp_path / "session", NAMES))
    known: SessionCalibration = calibration(solved(NAMES))
    late = session.with_lag(replace(known, lag=Lag(1.0, 0.1)).applied_lag)
    assert late.frames[2].readings == pytest.approx(session.frames[1].readings)
    assert replace(known, lag=Lag(0.1, 0.1, applied=False)).applied_lag is None
    assert replace(known, lag=None).applied_lag is None


def test_calibration_with_a_lag_is_used_by_batch_and_estimate(
    command: Command, bundled_body: Body, capsys: pytest.CaptureFixture[str]
) -> None:
    known = replace(calibration(solved(NAMES)), lag=Lag(1.0, 0.1))
    assert tuple(known.offsets)[2:] == bundled_body.instrument.joint_names
    write_json(Path("session.json"), known.to_dict())
    assert command("--session", "session.json").code in (0, 3)
    rows = read_session("session").frames
    assert result("0003")["readings"] == pytest.approx(rows[2].readings)
    single = ("estimate", "--mask", "session/masks/0003.png", "--camera", "session/camera.yaml", "--session")
    quick = ("session.json", "--config", "quick.toml", "--json")
    done = run_command(capsys, *single, *quick, "--joints", "session/joints.csv")
    assert json.loads(done.out)["readings"] == pytest.approx(rows[2].readings)
    done = run_command(capsys, *single, *quick, "--joints", "wrist_pitch=0.1,wrist_yaw=0.1,jaw=0.5")
    assert json.loads(done.out)["readings"] == {"wrist_pitch": 0.1, "wrist_yaw": 0.1, "jaw": 0.5}
    assert "the lag of 1 frames is not taken out of single readings" in done.err
    first = run_command(capsys, *single, *quick, "--joints", "session/joints.csv", "--frame", "0000")
    assert first.code == 2
    assert first.err == (
        "dvrk-cmaes: session/joints.csv: frame 0000: expected readings 1 frames before the image, got none\n"
    )
