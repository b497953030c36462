"""Agreement of the frames of a session: the published figures, the measures themselves and the command."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.commands import main
from helpers.places import bundled_path
from helpers.transforms import transform

from dvrk_cmaes import InputError, read_session
from dvrk_cmaes.evaluate.agreement import measure_agreement
from dvrk_cmaes.evaluate.consistency import base_spread, converge, converge_shafts, rcm_spread
from dvrk_cmaes.evaluate.result_set import read_result_set
from dvrk_cmaes.frames.truth import read_published_poses
from dvrk_cmaes.geometry import frame_along, rotation_about_z
from dvrk_cmaes.instrument.arm import base_from_root
from dvrk_cmaes.report.consistency_picture import draw_axes

DEMO = bundled_path("demo")
HEADER = "frame,rx,ry,rz,tx,ty,tz,wrist_pitch,wrist_yaw,jaw_2,jaw_1"


@pytest.fixture
def true_results(tmp_path: Path) -> Path:
    """Write the demo session's true poses as results with three fields a frame; returns the folder."""
    folder = tmp_path / "true"
    (folder / "frames").mkdir(parents=True)
    for name, truth in read_session(DEMO).truth.frames.items():
        document = {"camera_from_root": truth.camera_from_root.tolist(), "joints": dict(truth.joints), "seconds": 1.0}
        (folder / "frames" / f"{name}.json").write_text(json.dumps(document))
    return folder


# the measures


@pytest.mark.parametrize(
    ("level", "sigma", "rms", "rcm_mm", "base_deg"),
    [("easy", 0.00046, 0.00117, 6.9, 10), ("medium", 0.00243, 0.00474, 11.4, 23)],
)
def test_published_poses_give_published_figures(
    shared: Path, level: str, sigma: float, rms: float, rcm_mm: float, base_deg: float
) -> None:
    found = measure_agreement(read_result_set(shared / "frames" / "real" / level / "published.csv"))
    assert (round(found.axes.sigma, 5), round(found.axes.rms, 5)) == (sigma, rms)
    assert found.rcm is not None
    assert found.base is not None
    assert 1e3 * found.rcm.rms == pytest.approx(rcm_mm, abs=0.05)
    assert found.base.median_deg == pytest.approx(base_deg, abs=0.5)


def test_axes_through_point_converge_there() -> None:
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((8, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    meeting = np.array([0.01, -0.02, 0.13])
    found = converge(meeting + rng.uniform(-0.1, 0.1, (8, 1)) * directions, directions)
    np.testing.assert_allclose(found.point, meeting, atol=1e-12)
    assert found.rms < 1e-12


def test_poses_of_one_arm_share_rcm_and_base() -> None:
    rng = np.random.default_rng(2)
    outer = np.c_[rng.uniform(-0.4, 0.4, (6, 2)), rng.uniform(0.1, 0.18, 6), rng.uniform(-2, 2, 6)]
    camera_from_base = transform(frame_along([0.0, 0.6, -0.8]) @ rotation_about_z(0.7), [0.02, -0.05, 0.06])
    poses = camera_from_base @ base_from_root(outer)
    rcm, base = rcm_spread(poses, outer[:, 2]), base_spread(poses, outer)
    np.testing.assert_allclose(rcm.centre, camera_from_base[:3, 3], atol=1e-12)
    assert rcm.rms < 1e-12
    assert base.largest_deg < 1e-5
    np.testing.assert_allclose(converge_shafts(poses).point, camera_from_base[:3, 3], atol=1e-9)
    turned = outer + [0, 0, 0, np.deg2rad(9)] * (np.arange(6) == 3)[:, None]
    angles = base_spread(poses, turned).angles_deg
    np.testing.assert_allclose(angles, 9 * (np.arange(6) == 3), atol=1e-5)


# sets of results


# the command


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main(["consistency", *map(str, arguments)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_table_holds_sets_and_published_figures(shared: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [shared / "frames" / "real" / level / "published.csv" for level in ("easy", "medium")]
    code, out, err = run(capsys, *paths)
    rows = [line for line in out.splitlines() if "one by one" in line]
    assert (code, err) == (0, "")
    assert [line.split("one by one")[1].split()[0] for line in rows] == [
        *("0.00046", "0.00243"),
        *("0.00046", "0.05456", "0.00243", "0.06173", "0.00253", "0.06761"),
    ]


def test_json_output_and_picture(true_results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, true_results, "--session", DEMO, "--json", "--picture", tmp_path / "p" / "axes.svg")
    (found,) = json.loads(out)["sets"]
    assert code == 0
    assert set(found["distances_m"]) == set(found["base"]["rotation_deg"]) == {f"000{k}" for k in range(5)}
    assert json.loads(out)["paper"]["hard"] == {"sigma_m": 0.00253, "pnp_sigma_m": 0.06761}
    assert (tmp_path / "p" / "axes.svg").read_text().startswith("<svg ")


def test_picture_has_the_axes_of_each_set_and_leads_to_no_place(true_results: Path, tmp_path: Path) -> None:
    sets = [measure_agreement(read_result_set(true_results, DEMO))] * 2
    panels = ElementTree.fromstring(draw_axes(sets)).findall("{*}svg")
    assert len(panels) == 4
    whole, close = (panel.findall(".//{*}circle") for panel in panels[:2])
    assert len(whole) >= 5 + 2  # root links, x* and the camera
    assert len(close) >= 2 * 5  # nearest points and RCMs
    texts = " ".join(text.text or "" for text in panels[1].iterfind(".//{*}text"))
    assert f"rms {1e3 * sets[0].axes.rms:.2f} mm" in texts


def test_wrong_input_is_refused_without_output(
    true_results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    few = shutil.copytree(true_results, tmp_path / "few")
    for frame in ("0002", "0003", "0004"):
        (few / "frames" / f"{frame}.json").unlink()
    picture = tmp_path / "axes.svg"
    for arguments, expected in (
        ((), "RESULTS: expected at least one folder of results, got none"),
        ((few, "--picture", picture), f"{few}: axes: expected those of at least 3 frames, got 2"),
        ((tmp_path / "no",), f"{tmp_path / 'no'}: no such folder; expected results, with frames/FRAME.json"),
        (
            (few, "--picture", "axes.bmp"),
            "axes.bmp: expected a picture's name to end in .svg, got '.bmp'",
        ),
        ((few, few, few, *["--session", DEMO] * 2), "--session: expected one, or one for each of the 3 results, got 2"),
    ):
        code, out, err = run(capsys, *arguments)
        assert (code, out, err) == (2, "", f"dvrk-cmaes: {expected}\n")
    assert not picture.exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "frame,rx\n",
            "header: expected frame,rx,ry,rz,tx,ty,tz,wrist_pitch,wrist_yaw,jaw_2,jaw_1, got no ry, rz, tx, ty, ",
        ),
        (f"{HEADER}\n", "expected a row for each frame, got a header only"),
        (f"{HEADER}\na,0,0,0,0,0,x,0,0,0,0\n", "line 2: tz: expected a finite number, got 'x'"),
        (f"{HEADER}\na,0,0,0,0,0,0\n", "line 2: expected 11 cells as in the header, got 7"),
        (f"{HEADER}\n" + "a,0,0,0,0,0,1,0,0,0,0\n" * 2, "line 3: frame: expected each frame once, got 'a' again"),
    ],
)
def test_damaged_pose_table_is_refused_with_line(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "published.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_published_poses(path)
    assert str(caught.value).startswith(f"{path}: {expected}")
