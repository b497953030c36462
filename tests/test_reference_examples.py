"""The reference pages' commands and blocks, run as printed; those that need what is not here are checked by options.

The tutorial and the README have tests of their own; commands that stand in the README, too, run there alone.
"""

from __future__ import annotations

import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.files import read_mask
from helpers.made_examples import make_examples
from helpers.places import ROOT
from helpers.plain_pictures import plain_pictures, small_overlays, small_sessions
from helpers.printed_blocks import PROGRAM, Block, blocks, has_in_order, printed_parts, run, words
from helpers.processes_here import processes_here
from helpers.shared_estimates import shared_estimates, short_searches

from dvrk_cmaes import EstimateConfig, prepare, read_camera
from dvrk_cmaes.cli.app import app
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.io.toml_file import updated

PAGES = ROOT / "data" / "reference"
README = {line for block in blocks((ROOT / "README.md").read_text(encoding="utf-8")) for line in block.commands}
NOT_HERE = {
    "live": "a server",
    "--refine-camera": "more motion, as in tests/cli/test_calibrate.py",
    "150": "a long recording that is played to live, as a shorter one in tests/live/test_page.py",
    "--weights": "weights",
    "...": "a command that is not whole",
    "recording": "another laboratory's recording",
    "400181": "the dVRK's description of its instruments",
    "pictures": "a session without a camera file",
    **dict.fromkeys(
        ("endovis17", "jhu", "lincoln/by_hand", "ucsd19", "labels/f0.png", "raw/frame000.png"), "public data"
    ),
}
"""Words of commands that cannot run here, and what they need; their options are checked."""
WITH_OUTPUT = {"accuracy", "arms", "exports", "recordings", "results", "segmentation", "sessions"}
WITH_OUTPUT |= {"settings", "testing"}
"""Pages whose first screen shows the output of its command, which runs here."""
ELSEWHERE = {"tracking": "the tutorial", "uncalibrated": "tests/cli/test_calibrate.py"}
"""Pages whose first screen shows the output of a command that runs elsewhere."""
OTHER_PROGRAMS = ("pip install ", "ros2 ", "rerun ", "hf download ", "make demo ", "python scripts/")


class Example(NamedTuple):
    """A block of a page."""

    page: str
    block: Block

    @property
    def name(self) -> str:
        return f"{self.page}: {self.block.section}: {self.block.text.splitlines()[0][:50]}"


EXAMPLES = [
    Example(path.stem, block)
    for path in sorted(PAGES.glob("*.md"))
    if path.stem != "tutorial"
    for block in blocks(path.read_text(encoding="utf-8"))
]
COMMANDS = [each for each in EXAMPLES if each.block.commands]


def needed(command: str) -> str | None:
    """Return what a command needs that is not here."""
    return next((what for word, what in NOT_HERE.items() if word in shlex.split(command)), None)


@pytest.fixture(scope="module", autouse=True)
def quicker() -> Iterator[None]:
    """Let commands do without processes and pictures, search shortly, estimate once, and draw quarter-size images."""
    with processes_here(), shared_estimates(), short_searches(), plain_pictures(), small_overlays(), small_sessions():
        yield


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with all that the commands read."""
    home = tmp_path_factory.mktemp("inputs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        make_examples(home)
        (settings,) = (each for each in TOML if each.page == "settings")
        (home / "own.toml").write_text(settings.block.text)
        yield home
    shutil.rmtree(home)


@pytest.fixture
def folder(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder, which is the working directory."""
    home = tmp_path / "home"
    shutil.copytree(inputs, home, symlinks=True)
    monkeypatch.chdir(home)
    return home


def of_kind(pattern: str) -> list[Example]:
    """Give the blocks that are not of a shell and begin so."""
    others = [each for each in EXAMPLES if not each.block.commands]
    return [each for each in others if re.match(pattern, each.block.text)]


PYTHON = of_kind("from |import ")
TOML = of_kind(r"\[|seed = ")
LISTINGS = of_kind(r"recording/\n")
LINES = of_kind("warning: ")
SHOWN = of_kind("dvrk-cmaes: ")  # of `live`, as are its commands: tests/live/test_page.py
OUTPUTS = {
    before.name: after
    for before, after in pairwise(EXAMPLES)
    if before.page == after.page and before.block.commands and not before.block.text.startswith("$ ")
    if after not in [*COMMANDS, *PYTHON, *TOML, *LISTINGS, *LINES, *SHOWN]
    if not after.block.text.startswith(OTHER_PROGRAMS)
}
"""What pages show of the output of the block before, by its name."""


def test_every_block_is_known() -> None:
    known = [*COMMANDS, *PYTHON, *TOML, *LISTINGS, *LINES, *SHOWN, *OUTPUTS.values()]
    shells = [each for each in EXAMPLES if each.block.text.startswith(OTHER_PROGRAMS)]
    assert [each.name for each in EXAMPLES if each not in [*known, *shells]] == []
    assert [len(kind) for kind in (PYTHON, TOML, LISTINGS, LINES, SHOWN)] == [3, 2, 1, 1, 1]
    assert len(COMMANDS) > 20
    assert {each.page for each in OUTPUTS.values()} >= {*WITH_OUTPUT, *ELSEWHERE}
    for each in COMMANDS:
        shell = each.block.text.startswith("$ ")  # followed by its output, which tests/test_readme.py compares
        others = [line for line in each.block.lines if line and not PROGRAM.match(line)] if not shell else []
        assert [line for line in others if not line.startswith(OTHER_PROGRAMS)] == []


@pytest.mark.parametrize("example", COMMANDS, ids=lambda example: example.name)
def test_commands_run_as_printed(example: Example, request: pytest.FixtureRequest) -> None:
    shown = OUTPUTS.get(example.name)
    commands = [line for line in example.block.commands if shown or line not in README]
    for command in commands:
        check_options(command)
    if shown is not None and shown.page in ELSEWHERE:
        tutorial = [block.text for block in blocks((PAGES / "tutorial.md").read_text(encoding="utf-8"))]
        assert shown.page != "tracking" or shown.block.text in tutorial
        shown = None
    said = ""
    if run_here := [line for line in commands if needed(line) is None]:
        request.getfixturevalue("folder")
    for command in run_here:
        make_way(command)
        ran = run(command)
        assert ran.code in (0, 3), (command, ran.err)
        assert "Traceback" not in ran.err
        said += ran.out
    if shown is not None:
        assert run_here
        assert has_in_order(words(said), printed_parts(shown.block.text)), said


def make_way(command: str) -> None:
    """Remove what the command makes: a session of an earlier line of the block or page, or the truth of a made one."""
    tokens = shlex.split(command)
    if "record" in tokens:
        Path("session/golden.json").unlink()
    if "import" in tokens:
        shutil.rmtree(tokens[tokens.index("--out") + 1], ignore_errors=True)


def check_options(command: str) -> None:
    """Check that a command has the options, and takes their values."""
    tokens = shlex.split(PROGRAM.sub("", command))
    if "..." not in tokens:
        app.parse_args(tokens, exit_on_error=False, print_error=False)
        return
    own = {name for argument in app[tokens[0]].assemble_argument_collection() for name in argument.names}
    assert {token for token in tokens if token.startswith("--")} <= own


def test_wrong_options_are_found() -> None:
    with pytest.raises(Exception, match="bogus"):
        check_options("dvrk-cmaes batch session --bogus 3")
    with pytest.raises(Exception, match="every"):
        check_options("dvrk-cmaes import a.bag --out session --every often")
    with pytest.raises(AssertionError):
        check_options("dvrk-cmaes estimate ... --every 3")


@pytest.mark.parametrize("word", NOT_HERE)
def test_commands_that_cannot_run_are_few(word: str) -> None:
    of_word = [line for each in COMMANDS for line in each.block.commands if word in shlex.split(line)]
    assert 1 <= len(of_word) <= 3


@pytest.mark.parametrize("example", [each for each in PYTHON if each.page != "testing"], ids=lambda each: each.name)
def test_python_runs_as_printed(example: Example, folder: Path) -> None:
    left, right = (read_mask(f"{side}.png") for side in "lr")
    names: dict[str, Any] = {"body": prepare("lnd"), "left_mask": left, "right_mask": right, "readings": {}}
    names |= {"camera": read_camera("left.yaml"), "time": 0.0, "later": 0.1, "joints": {"jaw": 0.5}, "mask": left}
    names |= {"image": np.zeros((*left.shape, 3), np.uint8)}
    exec(compile(example.block.text, example.name, "exec"), names)
    assert names["result"].status in ("ok", "doubtful", "lost", "predicted")


def test_toml_is_read_as_printed(folder: Path) -> None:
    (settings,) = (each for each in TOML if each.page == "settings")
    config = updated(EstimateConfig(), tomllib.loads(settings.block.text), where="settings.md")
    assert (config.seed, config.search.samples) == (3, 1024)
    (session,) = (each for each in TOML if each.page == "arms")
    (folder / "session.toml").write_text(session.block.text)
    assert [tool.arm for tool in read_session_toml(folder).tools] == ["PSM1", "PSM2"]
