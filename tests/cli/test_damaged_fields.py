"""Inputs with one changed word, line or range of bytes: refused in one line, or the values read are still valid."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import main
from helpers.damage import INPUTS, Input, stopped_after_reading

from dvrk_cmaes import Body, DvrkCmaesError, Session

READ = "all was read"
TRIALS = 6
"""Number of changes tried for each input."""

REMARKS = ("dvrk-cmaes: warning: ", "Corrupt JPEG data: ")
"""Accepted further output: JPEG files have no checksum, and libjpeg prints a warning for data that it filled in."""

HOSTILE = [
    *("nan", "-inf", "1e400", "-1", "0", "1e-320", "99999999999999999999999", "9" * 5000, "null", "true", ""),
    *("[]", "{}", "''", "☃", "..", "/", "<", ",", "\\0", "\n", "-", "&a", "*a", "!!python/object:os.system"),
]


def changed(data: bytes, chance: random.Random) -> bytes:
    """Change one word or line of a text, or some bytes of other data."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = ""
    if "\0" in text or not text:
        place = chance.randrange(len(data))
        long = chance.choice((1, 4, 64))
        new = chance.choice((chance.randbytes(long), b"\xff" * long, bytes(long), b"", data[:long]))
        return data[:place] + new + data[place + long :]
    kind = chance.randrange(6)
    if kind == 0:
        lines = text.splitlines(keepends=True)
        line = chance.randrange(len(lines))
        return "".join(lines[:line] + lines[line : line + 1] * chance.choice((0, 2)) + lines[line + 1 :]).encode()
    word = chance.choice(list(re.finditer(r"[-+\w.]+|\W", text)))
    return (text[: word.start()] + chance.choice(HOSTILE) + text[word.end() :]).encode()


def check_frame(views: Sequence[Any], readings: dict[str, float], body: Body, *_: Any, **__: Any) -> None:
    """Check the inputs of an estimate, then stop the command."""
    ((mask, camera),) = [(view.mask, view.camera) for view in views]
    assert mask.dtype == np.bool_
    assert mask.shape == (camera.height, camera.width)
    assert np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]).all()
    assert np.isfinite(list(readings.values())).all()
    assert all(np.isfinite(link.vertices).all() for link in body.instrument.links)
    assert np.isfinite(body.instrument.limits).all()
    raise DvrkCmaesError(READ)


def check_session(session: Session, *_: object, **__: object) -> None:
    assert all(np.isfinite(list(frame.readings.values())).all() for frame in session.frames)
    raise DvrkCmaesError(READ)


@pytest.fixture(scope="module", autouse=True)
def read_only() -> Iterator[None]:
    """Let commands stop once their inputs are read and checked."""
    with stopped_after_reading(check_frame, check_session):
        yield


@pytest.mark.parametrize("one", INPUTS, ids=lambda one: one.name)
def test_single_change_is_refused_or_read_as_valid(
    one: Input, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    chance = random.Random(one.name)
    for trial in range(TRIALS):
        folder = tmp_path / str(trial)
        folder.mkdir()
        path = one.place(folder)
        data = changed(one.good(), chance)
        path.write_bytes(data)
        code = main([str(argument) for argument in one.arguments(path)])
        printed = capfd.readouterr()
        lines = [line for line in printed.err.splitlines() if not line.startswith(REMARKS)]
        if code == 2:
            assert printed.out == ""
            assert len(lines) == 1, (trial, printed.err)
            assert lines[0].startswith("dvrk-cmaes: ")
            assert len(lines[0]) < 1000, (trial, printed.err)
        else:
            assert (code, lines) in ((0, []), (1, [f"dvrk-cmaes: {READ}"])), (trial, printed.err)
        code = main(["inspect", str(path)])
        lines = [line for line in capfd.readouterr().err.splitlines() if not line.startswith(REMARKS)]
        assert (code, len(lines)) in ((0, 0), (2, 1)), (trial, lines)
