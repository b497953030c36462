"""session.toml: what it says, wrong entries, and the frames of each of several tools."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.batch_sessions import make_session

from dvrk_cmaes import InputError, read_frame, read_session
from dvrk_cmaes.frames.session_toml import CameraEntry, SessionEntries, ToolEntry, read_session_toml, session_toml

TWO_TOOLS = """
[camera]
file = "camera.yaml"
[[tool]]
arm = "PSM1"
instrument = "lnd"
label = 1
joints = "joints.csv"
[[tool]]
arm = "PSM2"
kinematics = "si"
instrument = "other/tool.urdf"
packages = {dvrk_model = "../model"}
label = 2
"""


def described(folder: Path, text: str) -> SessionEntries:
    """Write a session.toml and read it."""
    (folder / "session.toml").write_text(text, encoding="utf-8")
    return read_session_toml(folder)


def test_session_without_the_file_has_no_entries(tmp_path: Path) -> None:
    assert read_session_toml(tmp_path) == SessionEntries()


def test_paths_are_relative_to_the_session(tmp_path: Path) -> None:
    entries = described(tmp_path, TWO_TOOLS)
    assert entries.camera.file == tmp_path / "camera.yaml"
    first, second = entries.tools
    assert (first.arm, first.instrument, first.label) == ("PSM1", "lnd", (1,))
    assert first.joints == tmp_path / "joints.csv"
    assert second.instrument == str(tmp_path / "other" / "tool.urdf")
    assert second.packages == {"dvrk_model": tmp_path / "../model"}
    assert (second.kinematics, second.joints) == ("si", None)
    assert entries.tool("PSM2") is second


def test_written_entries_are_read_back(tmp_path: Path) -> None:
    camera = CameraEntry(left=Path("left.yaml"), right=Path("right.yaml"), rectified=True)
    tool = ToolEntry("PSM1", "si", 'a "b".urdf', {"dvrk_model": Path("/x y")}, "wrist", Path("t.json"), (3,))
    text = session_toml(camera, [tool, replace(tool, arm="PSM2", label=None, masks=Path("m"), joints=Path("j.csv"))])
    entries = described(tmp_path, text)
    assert (entries.camera.left, entries.camera.rectified) == (tmp_path / "left.yaml", True)
    first, second = entries.tools
    assert first == replace(tool, instrument=str(tmp_path / 'a "b".urdf'), tool=tmp_path / "t.json")
    assert (second.masks, second.joints, second.label) == (tmp_path / "m", tmp_path / "j.csv", None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[[tool]", "expected a session's description (TOML), got no valid TOML"),
        ('[[tool]]\narm = "PSM1"\nlable = 1', "unknown key tool.lable; the nearest known are label"),
        ('[camra]\nfile = "a"', "unknown key camra; the nearest known are camera"),
        ('[[tool]]\narm = "PSM1"\nlabel = 1.5', "label"),
        ('[[tool]]\nlabel = 1\n[[tool]]\narm = "a"\nlabel = 2', "arm"),
        ('[[tool]]\narm = "a"\nlabel = 1\n[[tool]]\narm = "a"\nlabel = 2', "tool.arm: expected a different one"),
        ('[[tool]]\narm = "a"\nlabel = 1\n[[tool]]\narm = "b"\nlabel = 1', "tool.label: expected a different one"),
        ('[[tool]]\narm = "a"\nlabel = 70000', "tool.label: expected a value of a mask, 0 to 65535"),
        ('[[tool]]\narm = "a"\n[[tool]]\narm = "b"\nlabel = 1', "tool a: expected either a label or a folder of masks"),
        ('[[tool]]\narm = "../a"', "expected a name that can be a file's"),
    ],
)
def test_wrong_entry_is_named(tmp_path: Path, text: str, expected: str) -> None:
    with pytest.raises(InputError) as caught:
        described(tmp_path, text)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_arm_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected one of PSM1, PSM2, got 'PSM3'"):
        described(tmp_path, TWO_TOOLS).tool("PSM3")


def write_labels(folder: Path, *places: slice) -> np.ndarray:
    """Write a mask of labels 1, 2, ... on parts of the columns, as the mask of frame 0000; returns it."""
    labels = np.zeros((120, 160), np.uint8)
    for label, columns in enumerate(places, start=1):
        labels[40:80, columns] = label
    (folder / "masks" / "0000.png").write_bytes(cv2.imencode(".png", labels)[1].tobytes())
    return labels


def test_each_tool_has_its_label_and_ignores_the_other(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "session", ["0000"])
    labels = write_labels(folder, slice(20, 60), slice(60, 110))
    described(folder, TWO_TOOLS)
    for arm, label in (("PSM1", 1), ("PSM2", 2)):
        session = read_session(folder, arm=arm)
        (files,) = session.frames
        data = read_frame(files, session.camera)
        np.testing.assert_array_equal(data.mask, labels == label)
        assert data.ignore is not None
        assert data.ignore[labels == 3 - label].all()
        assert not data.ignore[:, :15].any()
        assert 0 < data.ignore[labels == label].mean() < 0.1


def test_labels_may_be_in_a_folder_of_another_name(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "session", ["0000"])
    labels = write_labels(folder, slice(20, 60), slice(60, 110))
    (folder / "masks").rename(folder / "segmentation")
    described(folder, TWO_TOOLS.replace("label", 'masks = "segmentation"\nlabel'))
    session = read_session(folder, arm="PSM2")
    np.testing.assert_array_equal(read_frame(session.frames[0], session.camera).mask, labels == 2)


def test_tools_with_folders_of_masks_ignore_each_other(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "session", ["0000", "0001"])
    (folder / "other").mkdir()
    (folder / "masks" / "0001.png").rename(folder / "other" / "0000.png")
    text = '[[tool]]\narm = "PSM1"\nmasks = "masks"\n[[tool]]\narm = "PSM2"\nmasks = "other"\n'
    described(folder, text)
    first = read_session(folder, arm="PSM1")
    assert [tool.mask for tool in first.frames[0].other_tools] == [folder / "other" / "0000.png"]
    second = read_session(folder, arm="PSM2")
    assert second.frames[0].mask == folder / "other" / "0000.png"
    assert [tool.mask for tool in second.frames[0].other_tools] == [folder / "masks" / "0000.png"]


def test_label_of_a_tool_is_in_the_sessions_masks_where_another_names_a_folder(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "session", ["0000"])
    (folder / "masks").rename(folder / "first")
    (folder / "masks").mkdir()
    labels = write_labels(folder, slice(20, 60), slice(60, 110))
    described(folder, '[[tool]]\narm = "PSM1"\nmasks = "first"\n[[tool]]\narm = "PSM2"\nlabel = 2\n')
    first, second = (read_session(folder, arm=arm) for arm in ("PSM1", "PSM2"))
    (hidden,) = first.frames[0].other_tools
    assert (hidden.mask, hidden.label) == (folder / "masks" / "0000.png", (2,))
    np.testing.assert_array_equal(read_frame(second.frames[0], second.camera).mask, labels == 2)
