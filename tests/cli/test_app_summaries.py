"""The list of commands says of each what the first sentence of its own help says, and imports none of them."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dvrk_cmaes.cli.app import SUMMARIES, app


@pytest.mark.parametrize("name", SUMMARIES)
def test_listed_text_is_the_first_sentence_of_the_command(name: str) -> None:
    assert " ".join(app[name].help.partition("\n\n")[0].split()) == SUMMARIES[name]


@pytest.mark.parametrize("arguments", [[], ["--help"], ["--version"]], ids=" ".join)
def test_listing_the_commands_imports_none(arguments: list[str]) -> None:
    code = (
        "import sys; from dvrk_cmaes.cli.app import main; code = main(sys.argv[1:]);"
        "print(code, 'numpy' in sys.modules, 'dvrk_cmaes.cli.batch' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "0 False False"
