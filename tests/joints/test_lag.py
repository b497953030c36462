"""The lag between images and readings: its document, its text, and its use."""

from __future__ import annotations

import pytest

from dvrk_cmaes import InputError, Lag


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
