"""Damaged inputs, links, folders of the user, kills and pairs of commands, by the families of scripts/fuzz.py."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from helpers.places import SCRIPTS
from helpers.plain_pictures import plain_pictures

TIMES = float(os.environ.get("DVRK_CMAES_TEST_TRIES", "1"))
"""Multiplies the numbers of quick tries; .ci/run sets it to 3.4, and makes more of the others."""

ANY = 3 if TIMES <= 1 else 8  # tries by any command, 50 to 300 ms of processor time each; the others are by `inspect`
QUICK = 20 if TIMES <= 1 else 40  # tries of a family whose file `inspect` reads, some 5 ms each
NAMES = (
    *("mask", "mask, JPEG", "image", "camera", "camera, OpenCV", "readings", "session.toml", "readings, second arm"),
    *("mask, second arm", "readings, NumPy", "settings", "URDF", "mesh, DAE", "mesh, STL", "package", "texture"),
    *("tool", "result", "result, resumed", "run.json", "summary.json", "session.json", "golden.json", "tracks"),
    *("track's run.json", "video", "video, by name", "options"),
)


@pytest.fixture(scope="module")
def fuzz() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        yield importlib.import_module("fuzz")


@pytest.fixture(scope="module")
def material(fuzz: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("material")
    fuzz.write_material(folder)
    with fuzz.stubbed(folder), plain_pictures():
        yield folder


@pytest.mark.parametrize("name", NAMES)
def test_damaged_input_is_refused_in_one_line_or_read(
    fuzz: ModuleType, material: Path, tmp_path: Path, name: str
) -> None:
    assert [family.name for family in fuzz.FAMILIES] == [*NAMES]
    (family,) = (one for one in fuzz.FAMILIES if one.name == name)
    inspected = any(command[0] == "inspect" for command in family.commands)
    tries = range(max(ANY, round(TIMES * QUICK)) if inspected else ANY)
    report = fuzz.fuzz_inputs(family, tries, 0, material, tmp_path / "try", fuzz.in_this_process, quick=ANY)
    assert report.violations == []


def test_links_that_leave_a_session_are_not_followed(fuzz: ModuleType, material: Path, tmp_path: Path) -> None:
    quick = [("inspect", "session")]
    report = fuzz.fuzz_links(material, tmp_path / "try", fuzz.in_this_process, ("masks", "images"), quick)
    assert report.violations == []
    assert (report.tries.total(), report.refused) == (8, 8)


def test_no_file_of_the_user_is_changed_in_any_kind_of_folder(fuzz: ModuleType, material: Path, tmp_path: Path) -> None:
    report = fuzz.fuzz_folders(material, tmp_path / "try", fuzz.in_this_process, all_three=TIMES > 1)
    assert report.violations == []
    assert report.tries.total() >= 11 * 8


def test_changed_files_of_the_user_are_violations(fuzz: ModuleType, material: Path, tmp_path: Path) -> None:
    def careless(command: list[str]) -> object:
        if command[0] == "export":
            Path("session/camera.yaml").unlink()
        else:
            Path(command[-1]).mkdir(exist_ok=True)
        return fuzz.Outcome(0, "", "", 0.0)

    report = fuzz.fuzz_folders(material, tmp_path / "try", careless, ("export",))
    assert sum("changed or removed" in text and "session/camera.yaml" in text for text in report.violations) == 24


@pytest.mark.parametrize(
    ("command", "fault"),
    [("batch", "kill both"), ("import", "kill over an earlier result")],
)
def test_command_with_a_fault_ends_with_the_same_files_when_run_again(
    fuzz: ModuleType, material: Path, tmp_path: Path, command: str, fault: str
) -> None:
    report = fuzz.fuzz_kills(1, 0, material, tmp_path / "try", [command], [fault])
    assert report.violations == []
    assert report.tries == {f"{command} / {fault}": 1}


def test_two_commands_at_once_leave_what_each_alone_would(fuzz: ModuleType, material: Path, tmp_path: Path) -> None:
    report = fuzz.fuzz_pairs(1, 0, material, tmp_path / "try", ("estimate of two frames",))
    assert report.violations == []
    assert (report.tries.total(), report.refused) == (1, 0)


@pytest.mark.parametrize(
    ("code", "out", "err", "changed", "said"),
    [
        (2, "", "dvrk-cmaes: x\n", False, None),
        (2, "", "dvrk-cmaes: x\n", True, "files were written"),
        (2, "out", "dvrk-cmaes: x\n", False, "output"),
        (2, "", "libpng: x\ndvrk-cmaes: x\n", False, "2 lines"),
        (1, "", "dvrk-cmaes: internal error: x\n", False, "internal error"),
        (0, "fine", "", True, None),
        (-9, "", "", False, "exit code -9"),
    ],
)
def test_violations_are_seen(fuzz: ModuleType, code: int, out: str, err: str, changed: bool, said: str | None) -> None:
    outcome = fuzz.Outcome(code, out, err, 1.0)
    found = fuzz.violation_of(outcome, ["estimate"], changed=changed, unreadable=False)
    assert found is None if said is None else said in found
