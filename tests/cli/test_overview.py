"""The list of commands is printed without cyclopts and Rich, for terminals of any width."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dvrk_cmaes.cli import main, overview


@pytest.mark.parametrize("columns", [1, 30, 40, 79, 80, 100, 400])
def test_list_has_each_command_with_its_text_and_fits_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], columns: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main([]) == 0
    text = capsys.readouterr().out
    plain = " ".join(text.split())
    for name, summary in overview.SUMMARIES.items():
        assert f"\n  {name}" in text
        assert f" {name} {summary}" in plain
    assert columns < 30 or max(map(len, text.splitlines())) <= columns
    assert text.isascii()


def test_list_and_version_import_neither_cyclopts_nor_rich() -> None:
    for arguments in (["--help"], ["-h"], [], ["--version"]):
        code = (
            "import sys; from dvrk_cmaes.cli import main; code = main(sys.argv[1:]);"
            "print(code, sorted({'cyclopts', 'rich', 'numpy'} & set(sys.modules)))"
        )
        run = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
        assert run.stdout.splitlines()[-1] == "0 []"


def test_other_arguments_are_left_to_the_app(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["estimate", "--help"], ["--helo"], ["--help", "--debug"]):
        assert not overview.print_overview(arguments)
    assert capsys.readouterr().out == ""
