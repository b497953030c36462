"""The bundled instruments: closed meshes of the right size and shape, the dVRK's kinematics, and their script."""

from __future__ import annotations

import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from helpers.places import SCRIPTS, bundled_path

from dvrk_cmaes import Body, Camera, Instrument, Renderer, load_instrument, prepare

INSTRUMENTS = bundled_path("instruments")
FOLDER = INSTRUMENTS / "lnd"
SCRIPT = SCRIPTS / "make_instrument.py"
NUMBERS = {"prograsp": "400093", "maryland": "400172", "mega_needle_driver": "400194", "cautery_hook": "400183"}
LINKS = ["roll_link", "wrist_pitch_link", "jaw_1_link", "jaw_2_link"]


def mesh(link: str) -> trimesh.Trimesh:
    return trimesh.load_mesh(FOLDER / "meshes" / f"{link}.ply")


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, SCRIPT, *arguments], capture_output=True, text=True, check=False)


def joints() -> dict[str, ET.Element]:
    return {joint.attrib["name"]: joint for joint in ET.parse(FOLDER / "lnd.urdf").getroot().iter("joint")}


@pytest.mark.parametrize("path", sorted(INSTRUMENTS.glob("*/meshes/*.ply")), ids=lambda path: path.stem)
def test_meshes_are_closed_solids_with_outward_faces(path: Path) -> None:
    solid = trimesh.load_mesh(path)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.is_volume
    assert solid.body_count == 1


def test_number_of_triangles_is_at_most_20000() -> None:
    assert sum(len(mesh(link).faces) for link in LINKS) <= 20_000


def test_shaft_is_straight_cylinder_of_0_3_m() -> None:
    points = mesh("roll_link").vertices
    far_end = points[points[:, 2] < -0.3]
    rim = far_end[np.hypot(far_end[:, 0], far_end[:, 1]) > 0.004]
    assert len(rim) >= 96
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), 0.00407, atol=1e-8)
    start_of_end_piece = -0.00905
    assert start_of_end_piece - rim[:, 2].max() >= 0.3


def test_jaws_end_9_6_mm_from_yaw_axis() -> None:
    for link, side in (("jaw_1_link", -1), ("jaw_2_link", 1)):
        points = mesh(link).vertices
        tip = points[points[:, 1] > points[:, 1].max() - 1e-4]
        assert points[:, 1].max() == pytest.approx(0.0096, abs=1e-4)
        assert (tip[:, 0].min() + tip[:, 0].max()) / 2 == pytest.approx(side * 0.0005, abs=2e-4)


def test_closed_jaws_touch_without_overlap() -> None:
    blade_1, blade_2 = (mesh(link).vertices for link in ("jaw_1_link", "jaw_2_link"))
    assert blade_1[blade_1[:, 1] > 0.005][:, 0].max() == pytest.approx(0.0, abs=1e-7)
    assert blade_2[blade_2[:, 1] > 0.005][:, 0].min() == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    ("name", "parent", "child", "lower", "upper"),
    [
        ("wrist_pitch", "roll_link", "wrist_pitch_link", -1.39626, 1.39626),
        ("wrist_yaw", "wrist_pitch_link", "wrist_yaw_link", -1.39626, 1.39626),
        ("jaw", "wrist_yaw_link", "jaw_link", -0.349066, 1.39626),
        ("jaw_1", "wrist_yaw_link", "jaw_1_link", -1.5707, 1.5707),
        ("jaw_2", "wrist_yaw_link", "jaw_2_link", -1.5707, 1.5707),
    ],
)
def test_joints_have_dvrk_links_and_limits(name: str, parent: str, child: str, lower: float, upper: float) -> None:
    joint = joints()[name]
    assert joint.attrib["type"] == "revolute"
    assert joint.find("parent").attrib["link"] == parent
    assert joint.find("child").attrib["link"] == child
    assert joint.find("axis").attrib["xyz"].split() == ["0", "0", "1"]
    limit = joint.find("limit").attrib
    assert (float(limit["lower"]), float(limit["upper"])) == (lower, upper)


def test_tool_tip_frame_is_10_2_mm_from_yaw_axis() -> None:
    joint = joints()["tool_tip"]
    assert joint.attrib["type"] == "fixed"
    assert joint.find("origin").attrib["xyz"].split() == ["0", "0.0102", "0"]


def test_script_reproduces_bundled_files() -> None:
    done = run("--check")
    assert (done.returncode, done.stderr) == (0, "")


def test_check_names_changed_missing_and_extra_files(tmp_path: Path) -> None:
    copy = tmp_path / "instruments"
    shutil.copytree(INSTRUMENTS, copy)
    (copy / "lnd" / "lnd.urdf").write_text("<robot/>")
    (copy / "dvrk" / "meshes" / "roll.ply").unlink()
    (copy / "lnd" / "meshes" / "stray.ply").touch()
    done = run("--check", "--out", copy)
    assert done.returncode == 1
    assert [line.split(":")[0] for line in done.stderr.splitlines()] == [
        str(copy / "lnd" / "lnd.urdf"),
        str(copy / "dvrk" / "meshes" / "roll.ply"),
        str(copy / "lnd" / "meshes" / "stray.ply"),
    ]


def test_silhouette_agrees_with_scanned_needle_driver(bundled_body: Body, scanned_body: Body, clean_frames) -> None:
    poses, joints = clean_frames.camera_from_root, clean_frames.joints
    made, real = (Renderer(body, clean_frames.camera).masks(poses, joints) for body in (bundled_body, scanned_body))
    overlap = (made & real).sum(axis=(1, 2)) / (made | real).sum(axis=(1, 2))
    assert overlap.mean() >= 0.93
    assert overlap.min() >= 0.9


def poses_around(count: int) -> np.ndarray:
    """Poses of an instrument that is seen from directions spread over the sphere, 0.12 m away; (count, 4, 4)."""
    k = np.arange(count) + 0.5
    polar, angle = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    forward = -np.stack([np.cos(angle) * np.sin(polar), np.sin(angle) * np.sin(polar), np.cos(polar)], 1)
    right = np.cross([0.3, 0.5, 0.8], forward)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    poses[:, :3, 3] = [0, 0, 0.12] - poses[:, :3, 2] * 0.01
    return poses


def with_tube_of_real_radius(instrument: Instrument) -> Instrument:
    """A dVRK description whose tube, drawn with a radius of 4.37 mm, has that of a real one, 4.07 mm."""
    roll, *others = instrument.links
    radii, vertices = np.linalg.norm(roll.vertices[:, :2], axis=1), roll.vertices.copy()
    vertices[radii > 4.21e-3, :2] *= 4.07e-3 / radii.max()
    return replace(instrument, links=(replace(roll, vertices=vertices), *others))


@pytest.mark.parametrize("name", NUMBERS)
def test_silhouettes_from_40_directions_agree_with_the_dvrk_meshes(name: str, shared: Path) -> None:
    urdf = shared / "instruments" / "dvrk_model" / "urdf" / f"instrument_{NUMBERS[name]}.urdf"
    made, real = prepare(name), prepare(with_tube_of_real_radius(load_instrument(urdf)))
    assert made.instrument.joint_names == real.instrument.joint_names
    np.testing.assert_allclose(made.instrument.limits, real.instrument.limits, atol=1e-5)
    for ours, theirs in zip(made.instrument.jaw_tips, real.instrument.jaw_tips, strict=True):
        assert np.linalg.norm(ours.position - theirs.position) < 1e-4
    low, high = real.instrument.limits.T
    joints = np.random.default_rng(0).uniform(0.8 * low, 0.8 * high, (40, len(low)))
    camera = Camera(320, 240, 800.0, 800.0, 160.0, 120.0)
    ours, theirs = (Renderer(body, camera).masks(poses_around(40), joints) for body in (made, real))
    assert ((ours & theirs).sum((1, 2)) / (ours | theirs).sum((1, 2))).min() > 0.93


@pytest.mark.parametrize("name", NUMBERS)
def test_instrument_is_named_in_any_case_and_by_the_number_of_either_generation(name: str) -> None:
    for said in (name.upper(), NUMBERS[name], NUMBERS[name].replace("400", "420")):
        assert load_instrument(said).name == name
