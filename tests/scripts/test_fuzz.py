"""scripts/fuzz.py: damaged inputs of every family are refused in one line or read as valid; violations are seen."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from helpers.places import SCRIPTS

if TYPE_CHECKING:
    from fuzz import Outcome

TRIES = 12
NAMES = (
    *("mask", "mask, JPEG", "image", "camera", "camera, OpenCV", "readings", "readings, NumPy", "settings", "URDF"),
    *("mesh, DAE", "mesh, STL", "package", "texture", "tool", "result", "result, resumed", "run.json", "summary.json"),
    *("session.json", "golden.json", "tracks", "checkpoint", "track's run.json", "video", "options"),
)


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        from fuzz import stubbed
        from fuzz_families import write_material

        folder = tmp_path_factory.mktemp("material")
        write_material(folder)
        with stubbed(folder):
            yield folder


@pytest.mark.parametrize("name", NAMES)
def test_damage_is_refused_in_one_line_or_read_as_valid(material: Path, tmp_path: Path, name: str) -> None:
    from fuzz import attempt, in_this_process
    from fuzz_families import FAMILIES

    (family,) = (one for one in FAMILIES if one.name == name)
    for number in range(TRIES):
        command, _, violation = attempt(family, number, 0, material, tmp_path / "try", in_this_process)
        assert violation is None, (number, command)


def test_all_families_are_tested(material: Path) -> None:
    from fuzz_families import FAMILIES

    assert [family.name for family in FAMILIES] == [*NAMES]


def test_undamaged_material_is_accepted(material: Path, tmp_path: Path) -> None:
    import contextlib
    import shutil

    from fuzz import in_this_process, violation_of
    from fuzz_families import FAMILIES

    for number, family in enumerate(FAMILIES):
        shutil.copytree(material, tmp_path / str(number))
        with contextlib.chdir(tmp_path / str(number)):
            for command in family.commands[:1]:
                outcome = in_this_process([*command])
                assert outcome.code != 2, (family.name, outcome.err)
                assert violation_of(outcome, command, changed=False, unreadable=False) is None


@pytest.mark.parametrize(
    ("code", "out", "err", "changed", "told"),
    [
        (2, "", "dvrk-cmaes: x\n", False, None),
        (2, "", "dvrk-cmaes: x\n", True, "files were written"),
        (2, "out", "dvrk-cmaes: x\n", False, "output"),
        (2, "", "libpng: x\ndvrk-cmaes: x\n", False, "2 lines"),
        (1, "", "dvrk-cmaes: internal error: x\n", False, "internal error"),
        (1, "", "dvrk-cmaes: x\n", False, "exit code 1"),
        (0, "fine", "", True, None),
        (0, "", "Traceback (most recent call last):\n", False, "Traceback"),
        (-9, "", "", False, "exit code -9"),
    ],
)
def test_violations_are_seen(material: Path, code: int, out: str, err: str, changed: bool, told: str | None) -> None:
    from fuzz import Outcome, violation_of

    outcome: Outcome = Outcome(code, out, err, 1.0)
    found = violation_of(outcome, ["estimate"], changed=changed, unreadable=False)
    assert (found is None) if told is None else (found is not None and told in found)
