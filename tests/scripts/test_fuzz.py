"""scripts/fuzz.py: damaged inputs of every family are refused in one line or read as valid; violations are seen."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from helpers.budget import ANY, INSPECTED, SLOW, TIMES, quick_tries
from helpers.places import SCRIPTS
from helpers.plain_pictures import plain_pictures

if TYPE_CHECKING:
    from measure.fuzz.runs import Outcome

NAMES = (
    *(
        "mask",
        "mask, JPEG",
        "image",
        "camera",
        "camera, OpenCV",
        "readings",
        "session.toml",
        "readings, second arm",
        "mask, second arm",
        "readings, NumPy",
        "settings",
        "URDF",
    ),
    *("mesh, DAE", "mesh, STL", "package", "texture", "tool", "result", "result, resumed", "run.json", "summary.json"),
    *("session.json", "golden.json", "tracks", "track's run.json", "video", "video, by name", "options"),
)


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        from measure.fuzz.families import write_material
        from measure.fuzz.runs import stubbed

        folder = tmp_path_factory.mktemp("material")
        write_material(folder)
        with stubbed(folder), plain_pictures():
            yield folder


@pytest.mark.parametrize("name", NAMES)
def test_damage_is_refused_in_one_line_or_read_as_valid(material: Path, tmp_path: Path, name: str) -> None:
    from fuzz import attempt
    from measure.fuzz.families import FAMILIES
    from measure.fuzz.runs import in_this_process

    (family,) = (one for one in FAMILIES if one.name == name)
    quick = any(command[0] == "inspect" for command in family.commands)
    tries = quick_tries(SLOW.get(name, INSPECTED)) if quick or name in SLOW else ANY
    for number in range(tries):
        inspected = number >= ANY
        command, _, violation = attempt(
            family, number, 0, material, tmp_path / "try", in_this_process, inspected=inspected
        )
        assert violation is None, (number, inspected, command)


def test_material_is_restored_after_a_try(material: Path, tmp_path: Path) -> None:
    from fuzz import contents, restore

    place = tmp_path / "try"
    restore(material, place)
    before = contents(material)
    assert contents(place) == before
    (place / "session" / "joints.csv").write_text("damaged")
    (place / "video.avi").unlink()
    os.mkfifo(place / "video.avi")
    (place / "made" / "frames").mkdir(parents=True)
    (place / "made" / "frames" / "0000.json").write_text("{}")
    (place / "results" / "run.json").unlink()
    (place / "results" / "run.json").mkdir()
    restore(material, place)
    assert contents(place) == before


def test_links_that_leave_a_session_are_not_followed(material: Path, tmp_path: Path) -> None:
    from measure.fuzz.links import COMMANDS, KINDS, fuzz_links
    from measure.fuzz.runs import in_this_process

    quick = [command for command in COMMANDS if command[0] in ("inspect", "segment")]
    report = fuzz_links(material, tmp_path / "try", in_this_process, ("masks", "images"), quick)
    assert report.violations == []
    assert (report.tries, report.refused) == (4 * len(KINDS), 3 * len(KINDS))  # segment does not read the masks


def test_a_link_that_is_followed_is_a_violation(material: Path, tmp_path: Path) -> None:
    from measure.fuzz.links import fuzz_links
    from measure.fuzz.runs import in_this_process

    command = ("inspect", "session", "--follow-links")
    report = fuzz_links(material, tmp_path / "try", in_this_process, ("joints.csv",), [command])
    assert len(report.violations) == 2
    assert all("opened, changed or removed: ('beside/joints.csv'" in text for text in report.violations)


def test_tracker_refuses_damaged_input_and_comes_back(material: Path) -> None:
    from measure.fuzz.tracker import fuzz_tracker

    report = fuzz_tracker(300, 0)
    assert report.violations == []
    assert report.steps == 300
    assert report.refused > 20
    assert len(report.back) >= 5
    assert set(report.statuses) == {"doubtful", "lost"}  # without a calibration, no image is ok


@pytest.mark.usefixtures("material")
def test_live_outlives_faults_with_a_line_each() -> None:
    from measure.fuzz.live_faults import fuzz_live

    report = fuzz_live(3, 60, only=("clock set an hour back", "data too short", "steps that fail"))
    assert report.violations == []
    assert (report.lines, report.restarts, len(report.back)) == (3, 2, 3)


@pytest.mark.usefixtures("material")
def test_live_that_repeats_its_lines_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    from measure.fuzz import live_faults

    monkeypatch.setattr(live_faults, "RepeatedLines", lambda report: report)
    monkeypatch.setattr(live_faults, "BACK_WITHIN", 10)
    (violation,) = live_faults.fuzz_live(1, 10, only=("time of zero",)).violations
    assert violation.startswith("  fault 1, time of zero: 5 lines: /left/mask: header.stamp: expected the time")


@pytest.mark.parametrize(("command", "fault"), [("batch", "kill both"), ("export", "full disk"), ("track", "kill")])
def test_command_with_a_fault_ends_with_the_same_files_when_run_again(material: Path, command: str, fault: str) -> None:
    from measure.fuzz.kills import fuzz_kills

    report = fuzz_kills(1, 0, [command], [fault], material)
    assert report.violations == []
    assert report.tries == {f"{command} / {fault}": 1}


def test_faults_follow_each_other_until_there_are_enough(material: Path) -> None:
    from measure.fuzz.kills import fuzz_kills

    report = fuzz_kills(3, 1, ["export"], ["clock", "full disk"], material)
    assert report.violations == []
    assert report.faults == 3


def test_files_that_are_damaged_or_differ_are_seen(tmp_path: Path) -> None:
    from measure.fuzz.written import damaged_files, written

    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "a.json").write_text('{"x": 1, "seconds": 2}')
    (tmp_path / "made" / "b.csv").write_text("x,seconds\n1,2\n")
    first = written(tmp_path / "made")
    (tmp_path / "made" / "a.json").write_text('{"x": 1, "seconds": 3}')
    (tmp_path / "made" / "b.csv").write_text("x,seconds\n1,3\n")
    assert written(tmp_path / "made") == first
    (tmp_path / "made" / "b.csv").write_text("x,seconds\n2,2\n")
    assert written(tmp_path / "made") != first
    assert damaged_files(tmp_path / "made") == []
    (tmp_path / "made" / "a.json").write_text('{"x": 1, "sec')
    (message,) = damaged_files(tmp_path / "made")
    assert message.startswith("a.json is damaged")
    (tmp_path / "made" / "c.jpg").write_bytes(b"cut off")
    assert len(damaged_files(tmp_path / "made")) == 2


def test_all_families_are_tested(material: Path) -> None:
    from measure.fuzz.families import FAMILIES

    assert [family.name for family in FAMILIES] == [*NAMES]


def test_undamaged_material_is_accepted(material: Path, tmp_path: Path) -> None:
    import contextlib
    import shutil

    from fuzz import violation_of
    from measure.fuzz.families import FAMILIES
    from measure.fuzz.runs import in_this_process

    for number, family in enumerate(FAMILIES):
        shutil.copytree(material, tmp_path / str(number))
        with contextlib.chdir(tmp_path / str(number)):
            for command in family.commands[:1]:
                outcome = in_this_process([*command])
                assert outcome.code != 2, (family.name, outcome.err)
                assert violation_of(outcome, command, changed=False, unreadable=False) is None


def test_command_that_hangs_is_a_violation(material: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fuzz import violation_of
    from measure.fuzz import runs

    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    monkeypatch.setattr(runs, "SLOW", 0.5)
    monkeypatch.setattr("dvrk_cmaes.cli.app.app", lambda *_, **__: pipe.read_text())
    outcome = runs.in_this_process(["inspect"])
    found = violation_of(outcome, ["inspect"], changed=False, unreadable=False)
    assert found is not None
    assert "not ended after 1 s" in found


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
    from fuzz import violation_of
    from measure.fuzz.runs import Outcome

    outcome: Outcome = Outcome(code, out, err, 1.0)
    found = violation_of(outcome, ["estimate"], changed=changed, unreadable=False)
    assert (found is None) if told is None else (found is not None and told in found)


def test_no_file_of_the_user_is_changed_in_any_kind_of_folder(material: Path, tmp_path: Path) -> None:
    from measure.fuzz.folders import COMMANDS, KINDS, fuzz_folders
    from measure.fuzz.runs import in_this_process

    assert len(COMMANDS) == 12
    all_three = TIMES > 1
    report = fuzz_folders(material, tmp_path / "try", in_this_process, all_three=all_three)
    assert report.tries == (3 if all_three else 1) * len(KINDS) * len(COMMANDS)
    assert report.violations == []


def test_view_of_the_file_system_sees_files_that_are_changed(material: Path, tmp_path: Path) -> None:
    from measure.fuzz.folders import fuzz_folders
    from measure.fuzz.runs import Outcome

    def careless(command: list[str]) -> Outcome:
        if command[0] == "export":
            Path("session/camera.yaml").unlink()
            for path in Path(command[-1]).glob("*.txt"):
                path.write_text("replaced")
        else:
            Path(command[-1]).mkdir(exist_ok=True)
        return Outcome(0, "", "", 0.0)

    report = fuzz_folders(material, tmp_path / "try", careless, ("export",))
    assert sum("changed or removed" in text and "session/camera.yaml" in text for text in report.violations) == 24
    assert sum("written outside OUT" in text for text in report.violations) == 24
    assert sum("made/notes.txt" in text for text in report.violations) == 8


def test_killed_run_leaves_the_earlier_result_or_the_new_one(material: Path, tmp_path: Path) -> None:
    from measure.fuzz.earlier import fuzz_earlier

    report = fuzz_earlier(3, 0, material, tmp_path / "try", ("import",))
    assert report.earlier + report.new == 3
    assert report.violations == []


def test_two_commands_at_once_leave_what_each_alone_would(material: Path, tmp_path: Path) -> None:
    from measure.fuzz.together import fuzz_together

    report = fuzz_together(1, 0, material, tmp_path / "try", ("estimate of two frames",))
    assert report.violations == []
    assert (report.tries.total(), report.refused) == (1, 0)


@pytest.mark.usefixtures("material")
def test_files_that_no_list_names_or_that_differ_from_it_are_seen(tmp_path: Path) -> None:
    from measure.fuzz.together import list_faults

    from dvrk_cmaes.io.output import output, write_bytes

    with output(tmp_path / "made", "estimate"):
        write_bytes(tmp_path / "made" / "a.json", b"{}")
    assert list_faults(tmp_path / "made") == []
    (tmp_path / "made" / "a.json").write_bytes(b"[]")
    (tmp_path / "made" / "b.json").write_bytes(b"{}")
    (tmp_path / "made" / ".written.new").write_bytes(b"")
    assert list_faults(tmp_path / "made") == ["not as the list says: a.json, b.json", ".written.new is left"]
