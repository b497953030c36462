"""Inputs at the ends of ranges, special files, messages of native libraries: one line each, nothing left behind."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from helpers.batch_sessions import QUICK_CONFIG
from helpers.canned_results import canned
from helpers.commands import run_command
from helpers.demo_files import DEMO, IMAGE, frame
from helpers.waiting import within

from dvrk_cmaes import Body, Camera, InputError, estimate, load_instrument
from dvrk_cmaes.instrument.meshes import read_mesh

SMALL = Camera(fx=260, fy=260, cx=80, cy=60, width=160, height=120, distortion=())
MANY = "9" * 5000

ROBOT = """<robot name="x"><link name="roll_link"><visual><geometry>{shape}</geometry></visual></link>
<link name="tip"><visual><geometry><box size="0.01 0.01 0.01"/></geometry></visual></link>
<joint name="wrist_pitch" type="revolute"><parent link="roll_link"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="{lower}" upper="1" effort="1" velocity="1"/></joint></robot>"""


def small_mask(kind: str) -> np.ndarray:
    mask = np.zeros((120, 160), dtype=np.bool_)
    mask[{"pixel": (60, 80), "row": (60,), "column": (slice(None), 80), "rest": ()}[kind]] = True
    mask[0, 0] = mask[0, 0] and kind != "rest"
    return mask


@pytest.mark.parametrize("kind", ["pixel", "row", "column", "rest"])
def test_mask_of_few_pixels_has_a_result_that_is_never_ok(kind: str) -> None:
    large = Camera(fx=1040, fy=1040, cx=320, cy=240, width=640, height=480, distortion=())
    body = Body.prepare(load_instrument("lnd"))
    for mask, camera in ((small_mask(kind), SMALL), (np.pad(small_mask(kind), ((360, 0), (480, 0))), large)):
        result = estimate(mask, camera, {}, body, config=QUICK_CONFIG)
        assert result.status == "doubtful"
        assert json.dumps(result.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("command", "option", "value"),
    [
        ("estimate", "--seed", str(2**80)),
        ("estimate", "--seed", MANY),
        ("estimate", "--threads", str(2**31)),
        ("estimate", "--frame", MANY),
        ("segment", "--threads", "1000000"),
        ("batch", "--time-limit", "1e308"),
        ("batch", "--time-limit", "inf"),
        ("batch", "--time-limit", "1e10"),
        ("batch", "--workers", "1000000"),
        ("batch", "--scheduler", "garbage"),
        ("batch", "--scheduler", ""),
        ("batch", "--scheduler", "inproc://x"),
        ("batch", "--scheduler", "tls://host:8786"),
        ("batch", "--scheduler", "tcp://127.0.0.1:1"),
    ],
)
def test_extreme_option_is_refused_at_once(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, command: str, option: str, value: str
) -> None:
    first = {"estimate": frame(), "segment": ["segment", IMAGE, "--out", tmp_path / "x"]}
    words = first.get(command, [command, DEMO, "--out", tmp_path / "x"])
    with within(25):
        refusal = run_command(capfd, *words, option, value).refusal
    assert len(refusal) < 1000
    assert option in refusal or value[:10] in refusal
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("shape", "lower", "message"),
    [
        ('<box size="0.01 0.01 0.3"/>', "-1e308", "limit: expected at most 1000"),
        ('<box size="1e-300 0.01 0.3"/>', "-1", "box: 1e-300 m; expected at least 1e-07 m"),
    ],
)
def test_extreme_number_in_urdf_is_refused(tmp_path: Path, shape: str, lower: str, message: str) -> None:
    (tmp_path / "x.urdf").write_text(ROBOT.format(shape=shape, lower=lower))
    with pytest.raises(InputError, match=message):
        load_instrument(tmp_path / "x.urdf")


DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="1"/></asset>
<library_images><image id="i"><init_from>texture.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON><newparam sid="s"><surface type="2D"><init_from>i</init_from></surface>
</newparam><newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam><technique sid="c"><phong><diffuse>
<texture texture="t" texcoord="u"/></diffuse></phong></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>
<library_geometries><geometry id="g"><mesh><source id="s1"><float_array id="f" count="9">0 0 0 1 0 0 0 1 0</float_array>
<technique_common><accessor source="#f" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s1"/></vertices><triangles count="1" material="m">
<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry></library_geometries>
<library_nodes>{nodes}</library_nodes>
<library_visual_scenes><visual_scene id="scene"><node><instance_node url="#n0"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#scene"/></scene></COLLADA>"""
GEOMETRY = (
    '<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="m" target="#m"/>'
    "</technique_common></bind_material></instance_geometry>"
)


def test_texture_of_mesh_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "x.dae").write_text(DAE.format(nodes=f'<node id="n0">{GEOMETRY}</node>'))
    os.mkfifo(tmp_path / "texture.png")
    _, faces = read_mesh(tmp_path / "x.dae")
    assert len(faces) == 1


@pytest.mark.parametrize(("levels", "message"), [(9, "at most 10000 geometries"), (1, "contains itself")])
def test_nodes_that_multiply_are_refused(tmp_path: Path, levels: int, message: str) -> None:
    last = GEOMETRY if levels > 1 else '<instance_node url="#n0"/>'
    nodes = [f'<node id="n{k}">{f"""<instance_node url="#n{k + 1}"/>""" * 10}</node>' for k in range(levels)]
    (tmp_path / "x.dae").write_text(DAE.format(nodes="".join(nodes) + f'<node id="n{levels}">{last}</node>'))
    with pytest.raises(InputError, match=message):
        read_mesh(tmp_path / "x.dae")


def test_package_manifest_that_is_no_file_is_passed_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "package.xml")
    mesh = '<mesh filename="package://parts/x.stl"/>'
    (tmp_path / "x.urdf").write_text(ROBOT.format(shape=mesh, lower="-1"))
    with pytest.raises(InputError, match="no such file"):
        load_instrument(tmp_path / "x.urdf")


def result_with_pose(folder: Path, **changes: object) -> Path:
    """Write a results folder of one frame with changed fields."""
    (folder / "frames").mkdir(parents=True)
    document = canned("0000").to_dict() | changes
    (folder / "frames" / "0000.json").write_text(json.dumps(document))
    return folder


@pytest.mark.parametrize("number", [1e308, -1e308, 1e13, 1001.0])
@pytest.mark.parametrize("command", [["consistency"], ["export", "--to", "csv", "--out", "made"], ["compare", "other"]])
def test_results_with_far_away_poses_are_refused_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    command: list[str],
    number: float,
) -> None:
    monkeypatch.chdir(tmp_path)
    pose = canned("0000").to_dict()["camera_from_root"]
    pose[0][3] = number
    result_with_pose(tmp_path / "results", camera_from_root=pose)
    result_with_pose(tmp_path / "other")
    ran = run_command(capsys, command[0], "results", *command[1:])
    assert ran.code == 2
    expected = "results/frames/0000.json: camera_from_root: expected a translation of at most 1000 m, got [["
    assert ran.refusal.startswith(expected)
    assert not (tmp_path / "made").exists()
