"""Measurements on the meshes: shaft, jaw tips, skeleton and mirror twin."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.instrument_files import ALL_SHARED, HOOK, SCANNED, gripper, joint, loaded, write_urdf
from helpers.places import bundled_path
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dvrk_cmaes import InputError, load_instrument
from dvrk_cmaes.instrument import Shaft

LND = bundled_path("instruments", "lnd", "lnd.urdf")
FRACTION = st.floats(0.0, 1.0)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_urdf(tmp_path_factory.mktemp("small"), gripper())


def shaft_of(path: Path, **options: object) -> Shaft:
    shaft = load_instrument(path, **options).shaft  # type: ignore[arg-type]
    assert shaft is not None
    return shaft


def check_shaft(shaft: Shaft, radius: float, proximal: float, distal: float, tolerance: float = 1e-5) -> None:
    np.testing.assert_allclose(shaft.direction, [0, 0, 1], atol=1e-5)
    np.testing.assert_allclose(shaft.point, 0, atol=1e-6)
    assert shaft.radius == pytest.approx(radius, abs=tolerance)
    assert shaft.proximal_end == pytest.approx(proximal, abs=tolerance)
    assert shaft.distal_end == pytest.approx(distal, abs=tolerance)


# shaft


@pytest.mark.parametrize(("scale", "radius"), [("0.001", "0.00407 mm"), ("10", "40.7 mm")])
def test_instrument_whose_meshes_have_another_unit_is_refused(tmp_path: Path, scale: str, radius: str) -> None:
    shutil.copytree(LND.parent / "meshes", tmp_path / "meshes")
    text = LND.read_text()
    path = tmp_path / "scaled.urdf"
    path.write_text(text.replace('.ply"/>', f'.ply" scale="{scale} {scale} {scale}"/>'))
    with pytest.raises(InputError, match=re.escape(f"expected a shaft with a radius of 0.25 to 25 mm, got {radius}")):
        load_instrument(path)


@pytest.mark.shared
def test_scanned_shaft_excludes_flange() -> None:
    shaft = loaded(SCANNED).shaft
    assert shaft is not None
    check_shaft(shaft, 0.00407, -0.3237, -0.0090, 1e-4)


def test_radius_is_mean_half_width_over_views(tmp_path: Path) -> None:
    corners = [(0.004 * np.cos(a), 0.004 * np.sin(a)) for a in np.arange(12) * np.pi / 6]
    lines = [f"v {x} {y} {z}" for z in (-0.2, 0.0) for x, y in corners]
    lines += [f"f {k + 1} {(k + 1) % 12 + 1} {(k + 1) % 12 + 13} {k + 13}" for k in range(12)]
    (tmp_path / "prism.obj").write_text("\n".join(lines))
    shaft = shaft_of(write_urdf(tmp_path, gripper('<mesh filename="prism.obj"/>', "0 0 -0.02")))
    views = np.arange(0, np.pi, 1e-3)
    widths = np.ptp(np.array(corners) @ np.stack([np.cos(views), np.sin(views)]), axis=0)
    assert shaft.radius == pytest.approx(widths.mean() / 2, rel=1e-4)
    assert 0.004 * np.cos(np.pi / 12) < shaft.radius < 0.004


def test_oblique_axis_is_found_and_points_to_wrist(tmp_path: Path) -> None:
    for flip in (0.0, np.pi):
        place = f'<origin xyz="0.002 -0.001 -0.16" rpy="{0.1 + flip} -0.05 0"/>'
        body = gripper().replace('<origin xyz="0 0 -0.16"/>', place)
        assert place in body
        shaft = shaft_of(write_urdf(tmp_path, body))
        axis = Rotation.from_euler("xyz", [0.1, -0.05, 0]).apply([0, 0, 1])
        point = np.array([0.002, -0.001, -0.16])
        np.testing.assert_allclose(shaft.direction, axis, atol=1e-5)
        np.testing.assert_allclose(shaft.point, point - (point @ axis) * axis, atol=1e-6)
        assert shaft.length == pytest.approx(0.3, rel=0.06)  # the flange covers part of a tilted shaft


def test_a_link_without_a_straight_cylinder_has_no_shaft(small: Path) -> None:
    assert load_instrument(small, root_link="wrist_pitch_link").shaft is None


def test_shaft_is_found_from_root_above_roll_joint(tmp_path: Path) -> None:
    base = '<link name="base"/>' + joint(
        "roll", "revolute", "base", "roll_link", '<origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>'
    )
    check_shaft(shaft_of(write_urdf(tmp_path, base + gripper()), root_link="base"), 0.004, 0.09, 0.39, 5e-6)


# jaw tips


@pytest.mark.shared
def test_jaw_tips_of_scanned_instrument() -> None:
    tips = {loaded(SCANNED).links[tip.link].name: tip.position for tip in loaded(SCANNED).jaw_tips}
    assert np.linalg.norm(tips["jaw_1_link"] - [-0.0005, 0.0096, 0]) < 1e-4
    assert np.linalg.norm(tips["jaw_2_link"] - [0.0005, 0.0096, 0]) < 1e-4


@pytest.mark.shared
@pytest.mark.parametrize("path", [path for path in ALL_SHARED if path != HOOK], ids=lambda path: path.stem)
def test_jaw_tips_of_real_instruments(path: Path) -> None:
    instrument = loaded(path)
    assert len(instrument.jaw_tips) == 2
    for tip in instrument.jaw_tips:
        vertices = instrument.links[tip.link].vertices
        assert tip.position[1] == pytest.approx(vertices[:, 1].max(), abs=2e-4)
        assert np.linalg.norm(vertices - tip.position, axis=1).min() < 1e-3
    assert instrument.jaw_tips[0].position[0] * instrument.jaw_tips[1].position[0] < 0


@pytest.mark.shared
def test_cautery_hook_has_no_jaw_tips() -> None:
    hook = loaded(HOOK)
    assert hook.jaw_tips == ()
    assert hook.tips(np.zeros((4, 2))).shape == (4, 0, 3)
    assert hook.skeleton([0.1, 0.2]).shape[1] == 3


def test_jaw_tips_of_boxes_are_centres_of_ends(small: Path) -> None:
    first, second = loaded(small).jaw_tips
    np.testing.assert_allclose(first.position, [-0.001, 0.02 * 0.995, 0], atol=1e-9)
    np.testing.assert_allclose(second.position, [0.001, 0.02 * 0.995, 0], atol=1e-9)


# skeleton


# mirror twin


@given(pitch=FRACTION, yaw=FRACTION, jaw=FRACTION)
def test_tips_of_twin_coincide_in_reverse_order(pitch: float, yaw: float, jaw: float) -> None:
    lnd = loaded("lnd")
    joints = lnd.limits[:, 0] + np.ptp(lnd.limits, axis=1) * [pitch, yaw, jaw]
    half_turn, mirrored = lnd.twin(np.eye(4), joints)
    tips = lnd.tips(mirrored) @ half_turn[:3, :3].T + half_turn[:3, 3]
    np.testing.assert_allclose(tips[::-1], lnd.tips(joints), atol=1e-5)


@pytest.mark.shared
@pytest.mark.parametrize("path", ALL_SHARED, ids=lambda path: path.stem)
def test_real_instruments_except_hook_have_twin(path: Path) -> None:
    assert loaded(path).has_twin == (path != HOOK)
