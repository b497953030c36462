"""The README's commands and its Python, run as printed and in their order, in a folder beside the bundled data."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from typing import Any

import pytest
from helpers.places import ROOT
from helpers.plain_pictures import plain_pictures
from helpers.printed_blocks import PROGRAM, Output, blocks, has_in_order, printed_parts, run, words
from helpers.processes_here import processes_here
from helpers.shared_estimates import shared_estimates

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = list(blocks(README))
PYTHON = [block for block in BLOCKS if block.text.startswith("import ")]
SHELL = [block for block in BLOCKS if block not in PYTHON and PROGRAM.match(block.text)]
MAKE = [block for block in BLOCKS if block.text.startswith("make ")]
INSTALL = [block for block in BLOCKS if block.text.startswith("pip install ")]
PRINTED = [block for block in BLOCKS if block not in [*PYTHON, *SHELL, *MAKE, *INSTALL]]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Output]]:
    """Run the README's commands in their order, after making a video session; gives their output."""
    home = tmp_path_factory.mktemp("home")
    (home / "data").symlink_to(ROOT / "data")
    with pytest.MonkeyPatch.context() as patch, processes_here(), shared_estimates(), plain_pictures():
        patch.chdir(home)
        assert run("synth session --motion video --level easy --frames 3 --seed 1").code == 0
        (home / "session" / "golden.json").unlink()
        commands = [line for block in [*SHELL, *INSTALL] for line in block.lines if PROGRAM.match(line)]
        yield {line: run(line) for line in sorted(commands, key=lambda line: "calibrated" in line)}
    shutil.rmtree(home)


def test_every_block_is_known() -> None:
    assert (len(MAKE), len(INSTALL), len(PYTHON)) == (1, 1, 1)
    assert len(SHELL) >= 5
    assert all(PROGRAM.match(line) for block in SHELL for line in block.lines if line)
    assert {block.section for block in PRINTED} == {"One frame"}


def test_commands_run_as_printed(ran: dict[str, Output]) -> None:
    wrong = {line: (one.code, one.err) for line, one in ran.items() if one.code not in (0, 3)}
    assert wrong == {}
    assert not [line for line, one in ran.items() if "Traceback" in one.err]


def test_output_is_as_printed(ran: dict[str, Output]) -> None:
    command = next(one for one in SHELL if one.section == "One frame").lines[0]
    assert has_in_order(words(ran[command].out), printed_parts("\n".join(block.text for block in PRINTED)))


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
