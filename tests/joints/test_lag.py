"""The lag between images and readings: its document, its text, and its use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dvrk_cmaes import InputError, Lag
from dvrk_cmaes.io.typed_document import convert_document


def read(document: dict[str, object]) -> Lag:
    return convert_document("lag", document, Lag)


def test_document_states_lag_in_frames_and_seconds_with_its_sign() -> None:
    lag = Lag.of(0.134, 0.01, "s", 1 / 30, applied=True)
    assert lag.to_dict() == {
        "frames": 4.02,
        "std_frames": 0.3,
        "seconds": 0.134,
        "std_seconds": 0.01,
        "sign": "images late",
        "applied": True,
    }
    assert lag.describe() == "images are 4.02 frames (0.134 s) later than the readings, std 0.30 frames"
    early = Lag.of(-2.0, 0.1, "frames", 1.0, applied=True)
    assert early.describe() == "images are 2.00 frames earlier than the readings, std 0.10 frames"
    assert read(lag.to_dict()) == replace(lag, frames=4.02, std_frames=0.3)


def test_lag_that_drifts_is_that_of_its_middle() -> None:
    lag = Lag(6.0, seconds=0.2, drift=1e-3, std_drift=2e-4, middle=100.0)
    np.testing.assert_allclose(lag.at(np.array([0.0, 100.0, 150.0]), "s"), [0.1, 0.2, 0.25])
    document = lag.to_dict()
    assert (document["drift"], document["std_drift"], document["middle"]) == (1e-3, 2e-4, 100.0)
    assert lag.describe().endswith(", drifting by +1.00 parts per thousand")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0.13", Lag(None, seconds=0.13)),
        ("-0.05s", Lag(None, seconds=-0.05)),
        ("4frames", Lag(4.0)),
        ("1 frame", Lag(1.0)),
    ],
)
def test_lag_is_given_in_seconds_or_frames(text: str, expected: Lag) -> None:
    assert Lag.parse("--lag", text) == expected
    assert Lag.parse("--lag", expected.option.removeprefix("--lag ")) == expected


@pytest.mark.parametrize("text", ["", "four", "4 hours", "nan", "1e9", "9999frames", "1..2", "0.1,0.2"])
def test_wrong_lag_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"--lag: expected .*got "):
        Lag.parse("--lag", text)


def test_unit_that_is_not_known_is_refused() -> None:
    with pytest.raises(InputError, match="expected a lag in frames, such as 4frames, since the images have no times"):
        Lag(None, seconds=0.1).in_unit("frames")
    with pytest.raises(InputError, match=r"expected a lag in seconds, such as 0\.13, since the images have times"):
        Lag(4.0).in_unit("s")
