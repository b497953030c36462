"""Small files that claim or unfold into more than a machine has: refused in one line, at once, in little memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from bombs import BOMBS
from damage import frame
from instrument_files import mesh_link, write_urdf

QUICK, SMALL = 20.0, 150.0  # s and MB, of a machine that has much other work; a bomb takes minutes

CASES = [f"{what}, {name}" for what, files in BOMBS.items() for name, _ in files]


def arguments(what: str, path: Path, folder: Path) -> list[object]:
    """Give the command line that a bomb is given to."""
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
    """Set off all bombs in one child process."""
    folder = tmp_path_factory.mktemp("bombs")
    jobs: list[tuple[str, list[str]]] = []
    for what, files in BOMBS.items():
        for name, make in files:
            path = folder / what / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(make())
            jobs.append((f"{what}, {name}", [str(word) for word in arguments(what, path, folder / "robots")]))
    first = [("", ["import", "nothing.bag", "--out", "x"]), ("", [str(word) for word in frame(image="nothing.png")])]
    program = Path(__file__).with_name("bombs.py")
    done = subprocess.run(
        [sys.executable, str(program)],
        input=json.dumps({"first": first, "bombs": jobs}),
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        timeout=300,
    )
    assert not (folder / "bang").exists()
    assert not (folder / "made").exists()
    return {
        name: (code, said, seconds, grown)
        for name, code, said, seconds, grown in map(json.loads, done.stdout.splitlines())
    }


@pytest.mark.parametrize("case", CASES)
def test_a_bomb_is_refused_at_once_in_little_memory(
    outcomes: dict[str, tuple[int, str, float, float]], case: str
) -> None:
    code, said, seconds, grown = outcomes[case]
    assert said.startswith("dvrk-cmaes: ")
    assert said.count("\n") == 1
    assert len(said) < 1000
    assert code == 2, said
    assert seconds < QUICK, said
    assert grown < SMALL, said
