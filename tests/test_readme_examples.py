"""The README's commands and its Python, run as printed and in their order, in a folder beside the bundled data."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import subprocess
import textwrap
import tomllib
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import Any, NamedTuple

import pytest
from helpers.made_recordings import good, write_bag
from helpers.places import ROOT

from dvrk_cmaes.cli import main

README = (ROOT / "README.md").read_text(encoding="utf-8")
PROGRAM = re.compile(r"^(?:\.venv/bin/)?dvrk-cmaes ")


class Block(NamedTuple):
    """A block of code under a heading."""

    section: str
    text: str

    @property
    def lines(self) -> list[str]:
        """The lines, those that are continued joined, without comments."""
        return [shlex.join(shlex.split(line, comments=True)) for line in self.text.replace("\\\n", " ").splitlines()]


def blocks() -> list[Block]:
    """Give the indented blocks of the README; those of a shell end at an empty line."""
    found: list[Block] = []
    for section in README.split("\n## "):
        for match in re.finditer(r"(?:^    .*\n(?:\n(?=    ))?)+", section, flags=re.MULTILINE):
            text = textwrap.dedent(match[0])
            parts = [text] if text.startswith("import ") else text.split("\n\n")
            found += [Block(section.split("\n")[0], part) for part in parts]
    return found


BLOCKS = blocks()
PYTHON = [block for block in BLOCKS if block.text.startswith("import ")]
SHELL = [block for block in BLOCKS if block not in PYTHON and PROGRAM.match(block.text)]
MAKE = [block for block in BLOCKS if block.text.startswith("make ")]
INSTALL = [block for block in BLOCKS if block.text.startswith("pip install ")]
PRINTED = [block for block in BLOCKS if block not in [*PYTHON, *SHELL, *MAKE, *INSTALL]]


class Output(NamedTuple):
    """What a command printed, and its exit code."""

    code: int
    out: str
    err: str


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Output]]:
    """Run the README's commands in their order, after making a recording and a video session; gives their output."""
    home = tmp_path_factory.mktemp("home")
    (home / "data").symlink_to(ROOT / "data")
    write_bag(home / "suturing.bag", "ros1", good())
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        assert run("synth session --motion video --level easy --frames 3 --seed 1").code == 0
        (home / "session" / "golden.json").unlink()
        commands = [line for block in [*SHELL, *INSTALL] for line in block.lines if PROGRAM.match(line)]
        yield {line: run(PROGRAM.sub("", line)) for line in sorted(commands, key=lambda line: "calibrated" in line)}
    shutil.rmtree(home)


def run(command: str) -> Output:
    """Run a command line of the program."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(shlex.split(command))
    return Output(code, out.getvalue(), err.getvalue())


def words(text: str) -> list[str]:
    """Give the lines without their numbers, which may change in the last digit, and without the files written."""
    lines = [re.sub(r"[-+]?\d+(\.\d+)?", "#", line).split() for line in text.splitlines() if line.strip()]
    return [" ".join(line) for line in lines if line[0] != "written:"]


def test_every_block_is_known() -> None:
    assert (len(MAKE), len(INSTALL), len(PYTHON)) == (1, 2, 1)
    assert len(SHELL) >= 7
    assert all(PROGRAM.match(line) for block in SHELL for line in block.lines if line)
    assert [block.section for block in PRINTED] == ["One frame", "One arm, one camera"]


def test_commands_run_as_printed(ran: dict[str, Output]) -> None:
    wrong = {line: (one.code, one.err) for line, one in ran.items() if one.code not in (0, 3)}
    assert wrong == {}
    assert not [line for line, one in ran.items() if "Traceback" in one.err]


@pytest.mark.parametrize("block", PRINTED, ids=lambda block: block.section)
def test_output_is_as_printed(block: Block, ran: dict[str, Output]) -> None:
    command = next(one for one in SHELL if one.section == block.section).lines[0]
    assert words(ran[command].out) == words(block.text)


def test_python_runs_as_printed(ran: dict[str, Output]) -> None:
    text = PYTHON[0].text
    names: dict[str, Any] = {}
    exec(compile(text, "README.md", "exec"), names)
    assert names["result"].status == "ok"
    stated = re.search(r"result\.joints +# (\{.*\})", text)
    assert stated is not None
    assert names["result"].joints == pytest.approx(ast.literal_eval(stated[1]), abs=2e-3)
    for line in text.splitlines():  # expressions whose values are stated
        expression, _, comment = line.strip().partition("  # ")
        if comment.strip().startswith('"'):
            assert eval(expression, names) == ast.literal_eval(comment.strip())


def test_make_knows_the_targets() -> None:
    for line in MAKE[0].lines:
        target = shlex.split(line, comments=True)[1]
        planned = subprocess.run(["make", "--dry-run", target], cwd=ROOT, capture_output=True, text=True, check=False)
        assert planned.returncode == 0, planned.stderr


def test_installed_extras_exist() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    named = set(re.findall(r"pip install '[^'\[]*\[(\w+)\]'", README))
    assert "rosbag" in named
    assert named <= set(extras)
