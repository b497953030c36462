"""Damaged inputs of every command: one line that names the file, exit code 2, no traceback, nothing written."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from helpers.commands import main
from helpers.damage import DAMAGES, INPUTS, Input, stopped_after_reading

from dvrk_cmaes import DvrkCmaesError

READ = "all was read"

Refused = Callable[[Input, Callable[[Path, bytes], None]], str]


@pytest.fixture(scope="module", autouse=True)
def read_only() -> Iterator[None]:
    """Let commands stop with an error of their own once their inputs are read."""

    def stop(*_: object, **__: object) -> None:
        raise DvrkCmaesError(READ)

    with stopped_after_reading(stop, stop):
        yield


def run(arguments: list[object], capfd: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = main([str(argument) for argument in arguments])
    printed = capfd.readouterr()
    return code, printed.out, printed.err


@pytest.mark.parametrize("one", INPUTS, ids=lambda one: one.name)
def test_undamaged_input_is_read(one: Input, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = one.place(tmp_path)
    path.write_bytes(one.good())
    code, _, error = run(one.arguments(path), capfd)
    assert (code, error) in ((0, ""), (1, f"dvrk-cmaes: {READ}\n"))


@pytest.fixture
def refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Refused:
    """Run a command on a damaged file, check exit code and output, and give the line on stderr."""

    def go(one: Input, damage: Callable[[Path, bytes], None]) -> str:
        path = one.place(tmp_path)
        path.unlink(missing_ok=True)
        damage(path, one.good())
        arguments = one.arguments(path)
        before = sorted(tmp_path.rglob("*"))
        code, out, error = run(arguments, capfd)
        assert sorted(tmp_path.rglob("*")) == before
        assert out == ""
        assert error.startswith("dvrk-cmaes: ")
        assert error.count("\n") == 1
        assert len(error) < 1000
        assert code == 2, error
        assert path.name in error or path.parent.name in error
        return error

    return go


@pytest.mark.parametrize(
    ("one", "damage"),
    [
        pytest.param(one, damage, id=f"{one.name}, {kind}")
        for one in INPUTS
        for kind, damage in DAMAGES.items()
        if not (one.optional and kind == "missing")
    ],
)
def test_other_content_is_refused(refused: Refused, one: Input, damage: Callable[[Path, bytes], None]) -> None:
    refused(one, damage)


@pytest.mark.parametrize(
    ("one", "share"),
    [pytest.param(one, share, id=f"{one.name}, {share:.0%} left") for one in INPUTS for share in one.cuts],
)
def test_truncated_file_is_refused(refused: Refused, one: Input, share: float) -> None:
    refused(one, functools.partial(_cut, share))


@pytest.mark.parametrize(
    "one", [one for one in INPUTS if one.name.split()[0] not in ("ROS", "video")], ids=lambda one: one.name
)
def test_inspect_reports_damage_in_one_line(one: Input, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    cuts = {f"{share} left": functools.partial(_cut, share) for share in one.cuts}
    for number, (kind, damage) in enumerate([*DAMAGES.items(), *cuts.items()]):
        (tmp_path / str(number)).mkdir()
        path = one.place(tmp_path / str(number))
        path.unlink(missing_ok=True)
        damage(path, one.good())
        code, out, error = run(["inspect", path], capfd)
        assert (code, out) == (2, ""), (kind, out)
        assert error.startswith(f"dvrk-cmaes: {path}"), kind
        assert error.count("\n") == 1, error


def _cut(share: float, path: Path, data: bytes) -> None:
    path.write_bytes(data[: int(share * len(data))])
