"""Small files that claim or expand to huge sizes: refused in one line, quickly and with little memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.bombs import BOMBS
from helpers.demo_files import frame
from helpers.instrument_files import mesh_link, write_urdf
from helpers.places import HELPERS

QUICK, SMALL = 20.0, 150.0  # limits, s and MB, for a busy machine; reading a bomb would take minutes

CASES = [f"{what}, {name}" for what, files in BOMBS.items() for name, _ in files]


def arguments(what: str, path: Path, folder: Path) -> list[object]:
    """Give the command line that reads a bomb."""
    if what == "mesh":
        return frame(instrument=write_urdf(folder / path.name, mesh_link(str(path))))
    if what == "settings":
        return frame(config=path)
    if what == "result":
        return ["export", path, "--to", "csv"]
    if what == "recording":
        return ["import", path.parent if path.name == "metadata.yaml" else path, "--out", folder / "made"]
    return frame(**{what: path})


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str, float, float]]:
    """Read all bombs in one child process."""
    folder = tmp_path_factory.mktemp("bombs")
    jobs: list[tuple[str, list[str]]] = []
    for what, files in BOMBS.items():
        for name, make in files:
            path = folder / what / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(make())
            jobs.append((f"{what}, {name}", [str(word) for word in arguments(what, path, folder / "robots")]))
    first = [("", ["import", "nothing.bag", "--out", "x"]), ("", [str(word) for word in frame(image="nothing.png")])]
    program = HELPERS / "bombs.py"
    done = subprocess.run(
        [sys.executable, str(program)],
        input=json.dumps({"first": first, "bombs": jobs}),
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        timeout=1200,
    )
    assert not (folder / "bang").exists()
    assert not (folder / "made").exists()
    return {
        name: (code, said, seconds, grown)
        for name, code, said, seconds, grown in map(json.loads, done.stdout.splitlines())
    }


@pytest.mark.parametrize("case", CASES)
def test_bomb_is_refused_quickly_with_little_memory(
    outcomes: dict[str, tuple[int, str, float, float]], case: str
) -> None:
    code, said, seconds, grown = outcomes[case]
    assert said.startswith("dvrk-cmaes: ")
    assert said.count("\n") == 1
    assert len(said) < 1000
    assert code == 2, said
    assert seconds < QUICK, said
    assert grown < SMALL, said
