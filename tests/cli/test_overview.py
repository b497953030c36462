"""The list of commands is printed without cyclopts and Rich, and is what these would print."""

from __future__ import annotations

import io
import subprocess
import sys

import pytest

from dvrk_cmaes.cli import app, main, overview


class Output(io.StringIO):
    """A stream that may be a terminal, with an encoding."""

    def __init__(self, *, terminal: bool = False, encoding: str = "utf-8") -> None:
        super().__init__()
        self._terminal, self._encoding = terminal, encoding

    def isatty(self) -> bool:
        return self._terminal

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._encoding


def written(monkeypatch: pytest.MonkeyPatch, stream: Output, arguments: list[str], *, by_app: bool) -> str:
    with monkeypatch.context() as patch:
        patch.setattr("sys.stdout", stream)
        assert (app.main if by_app else main)(arguments) == 0
    return stream.getvalue()


@pytest.mark.parametrize("columns", [40, 60, 79, 80, 81, 93, 100, 120, 200, 400])
@pytest.mark.parametrize("terminal", [False, True])
def test_list_is_that_of_the_app(monkeypatch: pytest.MonkeyPatch, columns: int, terminal: bool) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm-256color")
    ours, theirs = (written(monkeypatch, Output(terminal=terminal), [], by_app=by_app) for by_app in (False, True))
    assert _without_styles(ours) == _without_styles(theirs)
    assert ("\x1b[36m" in ours) == ("\x1b[36m" in theirs)


def _without_styles(text: str) -> str:
    return text.replace("\x1b[36m", "").replace("\x1b[0m", "")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_stdout_that_cannot_take_the_frame_gets_the_list_of_the_app(
    monkeypatch: pytest.MonkeyPatch, encoding: str
) -> None:
    ours, theirs = (written(monkeypatch, Output(encoding=encoding), [], by_app=by_app) for by_app in (False, True))
    assert ours == theirs
    assert "╭" not in ours


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
