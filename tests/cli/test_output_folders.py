"""Results of another session are refused, also where folders were moved."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.places import bundled_path

from dvrk_cmaes import InputError, read_session
from dvrk_cmaes.runs.manifest import check_same_session, frame_stamps

DEMO = bundled_path() / "demo"


def written(folder: Path, **texts: str) -> None:
    """Write files; ``__`` in a name is a slash."""
    for name, text in texts.items():
        path = folder / name.replace("__", "/").replace("_json", ".json").replace("_png", ".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def as_session(folder: Path) -> None:
    shutil.copytree(DEMO, folder, dirs_exist_ok=True)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """The bundled session, in a folder that may be written to."""
    as_session(tmp_path / "session")
    return tmp_path / "session"


def run_of(session: Path, frames: dict[str, Any]) -> str:
    return json.dumps(
        {"version": "1", "session": str(session), "instrument": {"name": "lnd"}, "config": {}, "frames": frames}
    )


def test_calibration_of_another_session_is_distinguished_from_one_that_was_moved(session: Path, tmp_path: Path) -> None:
    read, out = read_session(session), tmp_path / "out"
    digests = {files.name: frame_stamps(files) for files in read.frames}
    other = {name: dict.fromkeys(parts, "other") for name, parts in digests.items()}
    written(out, run_json=run_of(session, other))
    check_same_session(out, read)
    written(out, run_json=run_of(tmp_path / "before", digests))
    check_same_session(out, read)
    written(out, run_json=run_of(tmp_path / "before", other))
    with pytest.raises(InputError, match=r"it has the results of another session \("):
        check_same_session(out, read)
