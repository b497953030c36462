"""What a document may cost in memory, whatever is in it: bounds on its size and depth hold before it is parsed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.session_toml import read_session_toml
from dvrk_cmaes.io.json_file import read_json
from dvrk_cmaes.io.toml_file import read_toml
from dvrk_cmaes.io.yaml_file import check_yaml, read_yaml_by_frame, read_yaml_mapping
from dvrk_cmaes.joints.reading import read_joint_file
from dvrk_cmaes.recording.bag import open_bag
from dvrk_cmaes.recording.recording import Asked
from dvrk_cmaes.recording.topics import TopicRequest

MOST_MB = 300


def refused(read: Callable[[], object]) -> str:
    """Return the message with which reading is refused."""
    with pytest.raises(InputError) as refusal:
        read()
    return str(refusal.value)


READ = r"""
import gc, json, os, re, sys
from pathlib import Path
from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.json_file import read_json
from dvrk_cmaes.io.toml_file import read_toml
from dvrk_cmaes.io.yaml_file import read_yaml_by_frame, read_yaml_mapping
from dvrk_cmaes.joints.reading import read_joint_file

readers = {
    "json": lambda path: read_json(path, expected="JSON"),
    "toml": lambda path: read_toml(path, expected="TOML"),
    "yaml": lambda path: read_yaml_mapping(path, expected="YAML"),
    "frames": lambda path: read_yaml_by_frame(path, expected="YAML"),
    "messages": read_joint_file,
}
def peak():
    return int(re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())[1])


gc.disable()  # takes half of the time and frees nothing
for reader, path in json.load(sys.stdin):
    if os.fork() == 0:  # a process of its own, whose peak begins at what it uses
        said, last, before = "", "", peak()
        try:
            found = readers[reader](Path(path))
            last = repr(list(found.items())[-1])[:300] if isinstance(found, dict) else ""
        except InputError as error:
            said = str(error)
        print(json.dumps([said, (peak() - before) // 1024, last]), flush=True)
        os._exit(0)
    os.wait()
"""
"""Prints what is said of each document, by how many MB the peak of a process's memory grows while it reads it, and the
last value of a mapping.

Each is read in a process of its own, of which none has to import the package again.
"""

MESSAGE = "header: {stamp: {sec: %d, nanosec: 0}}\nname: [jaw]\nposition: [0.1]\nvelocity: [%s0]\n---\n"

POINTS = "".join(f"  {number}: [700.5, 400.25]\n" for number in range(1, 15))
"""Labels of a frame."""

COSTLY: dict[str, tuple[str, Callable[[], str]]] = {
    "most lists": ("json", lambda: "[" + "[]," * 2_999_990 + "0]"),
    "too many lists": ("json", lambda: "[" + "[]," * 6_600_000 + "0]"),
    "nested lists": ("json", lambda: "[" * 1_000_000),
    "long text": ("json", lambda: '"' + "a" * 19_000_000 + '"'),
    "one key": ("toml", lambda: ".".join("a" * 490_000) + " = 1\n"),
    "many keys": ("toml", lambda: "".join(f"a{k}." + ".".join("a" * 18) + "=1\n" for k in range(21_000))),
    "many tables": ("toml", lambda: "[[a]]\n" * 160_000),
    "nested arrays": ("toml", lambda: "a = " + "[" * 900_000),
    "many empty lists": ("yaml", lambda: "a: [" + "[]," * 330_000 + "0]"),
    "deep lists": ("yaml", lambda: "a: " + "[" * 900_000),
    "most frames": ("frames", lambda: "".join(f"{frame}:\n{POINTS}" for frame in range(5400))),
    "most empty lists of frames": ("frames", lambda: "[" + "[]," * 199_000 + "0]"),
    "longest texts of frames": ("frames", lambda: f"- {'x' * 47}\n" * 390_000),
    "too many frames": ("frames", lambda: "- 0\n" * 4_000_000),
    "large messages": ("messages", lambda: "".join(MESSAGE % (k, "[]," * 6000) for k in range(55))),
}
"""Documents close to the bounds, or beyond them, by what is costly in them."""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, int, str]]:
    """What is said of each document, how much memory its reading takes, MB, and its last value."""
    folder, jobs = tmp_path_factory.mktemp("documents"), []
    for number, (reader, text) in enumerate(COSTLY.values()):
        path = folder / str(number) / "document"
        path.parent.mkdir()
        path.write_text(text())
        jobs.append((reader, str(path)))
    done = subprocess.run(
        [sys.executable, "-c", READ], input=json.dumps(jobs), capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    shutil.rmtree(folder)
    return {kind: tuple(json.loads(line)) for kind, line in zip(COSTLY, done.stdout.splitlines(), strict=True)}


@pytest.mark.parametrize("kind", COSTLY)
def test_memory_for_a_document_is_bounded(outcomes: dict[str, tuple[str, int, str]], kind: str) -> None:
    said, megabytes, _ = outcomes[kind]
    assert megabytes < MOST_MB
    assert "\n" not in said


def test_key_of_many_parts_is_refused_in_session_and_settings(tmp_path: Path) -> None:
    path = tmp_path / "session.toml"
    path.write_text(".".join("a" * 21) + " = 1\n")
    for read in (lambda: read_session_toml(tmp_path), lambda: read_toml(path, expected="settings (TOML)")):
        assert f"{path}: expected " in (said := refused(read))
        assert "got a key of more than 20 parts" in said


def test_dots_in_texts_and_numbers_are_not_parts_of_keys(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    numbers = ", ".join("1.5" for _ in range(30))
    path.write_text(f'a = "{"../" * 30}x"\nb = [{numbers}]\nc = {{x = \'{"." * 30}\'}}\n"d.{"." * 30}" = 1\n')
    assert read_toml(path, expected="TOML")["a"].startswith("../..")


def test_too_many_values_are_refused_before_parsing(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text("[" + "0," * 6_000_001 + "0]")
    assert refused(lambda: read_json(path, expected="a result")).endswith("values; at most 6000000 are read")


@pytest.mark.parametrize(
    "read",
    [
        lambda path: read_json(path, expected="x"),
        lambda path: read_toml(path, expected="x"),
        lambda path: read_yaml_mapping(path, expected="x"),
        lambda path: read_yaml_by_frame(path, expected="x"),
        read_joint_file,
    ],
)
def test_sparse_file_is_refused_by_its_size(tmp_path: Path, read: Callable[[Path], object]) -> None:
    path = tmp_path / "document"
    path.touch()
    os.truncate(path, 3_000_000_000)
    assert " MB, got 3000.0 MB" in refused(lambda: read(path))


def test_values_of_five_thousand_frames_are_read(outcomes: dict[str, tuple[str, int, str]]) -> None:
    said, _, last = outcomes["most frames"]
    assert said == ""
    assert last == repr((5399, {number: [700.5, 400.25] for number in range(1, 15)}))


def test_more_values_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "keypoints.yaml"
    path.write_text("- 0\n" * 400_001)
    assert refused(lambda: read_yaml_by_frame(path, expected="labels")).endswith("got YAML of more than 400000 items")


def test_metadata_of_a_recording_is_bounded_before_rosbags_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "metadata.yaml"
    path.touch()
    os.truncate(path, 3_000_000_000)
    requested = TopicRequest(None, None, None, None)

    def opened() -> None:
        with open_bag(tmp_path, requested, Asked()):
            raise AssertionError("opened")

    assert "metadata.yaml: expected metadata of a ROS 2 recording of at most 1 MB" in refused(opened)
    path.write_text("a: " + "[" * 30 + "]" * 30)
    assert refused(opened).endswith("got YAML of more than 20 levels")
    path.write_text(f"a: {'x' * 50_000}")
    check_yaml(path, expected="metadata", longest=100_000)
