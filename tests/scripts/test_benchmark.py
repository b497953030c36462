"""scripts/run_benchmark.py: scores are exact, submissions are checked, methods see no truth, M3T's files fit."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import trimesh
import yaml
from helpers.commands import Ran
from helpers.places import ROOT
from scipy.stats import norm

from dvrk_cmaes import Renderer, prepare, read_session
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.frames.boxes import read_boxes
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.frames.markers import read_detections
from dvrk_cmaes.geometry import apply, exp_rotation, moved, transform
from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.instrument.arm import OUTER_JOINTS

if TYPE_CHECKING:
    from benchmark.score import Scores
    from benchmark.submission import Row
    from benchmark.tasks import Given, TaskName

pytestmark = pytest.mark.usefixtures("scripts_on_path")

TRUE = transform(exp_rotation([0.3, -0.4, 0.5]), [0.01, -0.02, 0.12])
JOINTS = np.array([0.1, -0.2, 0.6])
NAMES = ("wrist_pitch", "wrist_yaw", "jaw")


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., Given]:
    """A task whose truth is the same in each frame, or with changes by frame; its base is TRUE."""

    def make(task: TaskName, frames: int, **changes: Mapping[str, Any]) -> Given:
        from benchmark.tasks import Given, table
        from worlds.folders import Folder

        ends = apply(TRUE, load_instrument("lnd").ends(JOINTS)).tolist()
        truth = {"T_camera_roll_link": TRUE.tolist(), "joints": dict(zip(NAMES, JOINTS.tolist(), strict=True))}
        truth |= {"tips_camera_m": ends, "visible": 1.0, "overlap": 1.0}
        world = replace(table()[4], number=4)
        folder = Folder(tmp_path, world, "session" if task in ("frame", "base") else "recording", frames)
        golden = {name: truth | changes.get(f"f{name}", {}) for name in folder.names}
        (tmp_path / "golden.json").write_text(json.dumps({"camera_from_base": TRUE.tolist(), "frames": golden}))
        return Given(task, folder, folder)

    return make


def a_row(task: TaskName, frame: int | str, status: str = "ok", change: Any = (0.0,) * 9, **stated: Any) -> Row:
    """A row that is off the truth by a change (6 + J,) in its own axes: true = moved(found, change)."""
    from benchmark.submission import Row

    change = np.asarray(change, np.float64)
    back = transform(exp_rotation(change[3:6]), change[:3])
    joints = None if task == "base" else JOINTS - change[6:]
    name = frame if isinstance(frame, str) else f"{frame:04d}"
    return Row(task, 4, name, status, TRUE @ np.linalg.inv(back), joints, **stated)


def scores_of(given: Given, rows: list[Row]) -> Scores:
    from benchmark.score import score_world

    return score_world(given, {row.frame: row for row in rows})


# the scorer against rows with known errors


def test_errors_are_exact(made: Callable[..., Given]) -> None:
    from benchmark.score import score_row

    given = made("frame", 4, f0003={"visible": 0.4})
    shifted, bent = np.zeros(9), np.zeros(9)
    shifted[:3], bent[6:] = [0.003, 0.0, 0.004], [0.0, 0.0, 0.3]
    rows = [a_row("frame", 0), a_row("frame", 1, change=shifted), a_row("frame", 2, "doubtful", bent)]
    scores = scores_of(given, rows)
    assert [frame.frame for frame in scores.frames] == ["0000", "0001", "0002"]  # one is hidden
    assert [frame.error_mm for frame in scores.frames[:2]] == pytest.approx([0, 5], abs=1e-9)
    assert scores.root_mm == pytest.approx([0, 5, 0], abs=1e-9)
    assert scores.joints_deg == pytest.approx([0, 0, np.degrees(0.1)], abs=1e-9)
    assert [frame.wrong for frame in scores.frames] == [False, True, False]
    row = score_row("a", "frame", [scores])
    assert (row["frames"], row["ok and wrong"], row["recordings wrong"]) == (3, 1, None)
    assert (row["ok"], row["worst ok, mm"]) == pytest.approx((2 / 3, 5.0))
    tilted = np.zeros(9)
    tilted[3] = np.deg2rad(2.0)
    assert scores_of(given, [a_row("frame", 0, change=tilted)]).shaft_deg == pytest.approx([2.0])


def test_twin_and_missing_rows_are_errors_and_a_large_std_excuses_nothing(made: Callable[..., Given]) -> None:
    from benchmark.score import score_row
    from benchmark.submission import Row

    given, instrument = made("frame", 3), load_instrument("lnd")
    twin, joints = instrument.twin(TRUE, JOINTS)
    rows = [Row("frame", 4, "0000", "ok", twin, joints, std=np.full(9, 5.0)), Row("frame", 4, "0001", "failed")]
    scores = scores_of(given, rows)
    row = score_row("a", "frame", [scores])
    assert row["right mode"] == 0
    assert scores.frames[0].rotation_deg == pytest.approx(180)
    assert [frame.error_mm for frame in scores.frames[1:]] == [1000, 1000]
    assert [frame.status for frame in scores.frames] == ["ok", "failed", "failed"]
    far = a_row("frame", 0, change=[0.01, *[0.0] * 8], std=np.full(9, 5.0))
    assert [frame.wrong for frame in scores_of(given, [far]).frames] == [True, False, False]


def test_coverage_is_the_share_of_stated_intervals(made: Callable[..., Given]) -> None:
    from benchmark.score import LEVELS, coverage, reliability, score_row

    given = made("frame", 3)
    std = np.array([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    off = std * [2.0, 1.0, 0, 0, 0, 0, 1.0, -0.5, 0]  # in standard deviations
    doubtful = a_row("frame", 1, "doubtful", 9 * std, std=std)
    scores = scores_of(given, [a_row("frame", 0, change=off, std=std), doubtful, a_row("frame", 2)])
    (ratios,) = scores.ratios
    assert np.abs(ratios) == pytest.approx([2, 1, 0, 0, 0, 0, 1, 0.5, 0], abs=1e-9)
    assert coverage(scores.ratios, 0.9) == pytest.approx(8 / 9)
    assert coverage(scores.ratios, 2 * norm.cdf(0.9) - 1) == pytest.approx(6 / 9)
    assert coverage(scores.ratios, 0.99) == 1
    assert reliability([scores]) == pytest.approx([coverage(scores.ratios, level) for level in LEVELS])
    assert reliability([scores_of(given, [a_row("frame", 0)])]) is None
    assert score_row("a", "frame", [scores])["90 % regions"] is None


def test_covariance_states_a_region(made: Callable[..., Given]) -> None:
    from benchmark.score import score_row

    given = made("frame", 2)
    matrix = np.eye(9) * 1e-6
    matrix[0, 1] = matrix[1, 0] = 0.8e-6
    along, across = np.zeros(9), np.zeros(9)
    along[:2], across[:2] = 3e-3, [3e-3, -3e-3]
    rows = [a_row("frame", 0, change=along, covariance=matrix), a_row("frame", 1, change=across, covariance=matrix)]
    scores = scores_of(given, rows)
    assert scores.squares == (pytest.approx((18 / 1.8, 9)), pytest.approx((18 / 0.2, 9)))
    assert score_row("a", "frame", [scores])["90 % regions"] == 0.5  # 14.7 is the limit


def test_recording_is_wrong_if_more_than_a_fifth_of_its_ok_frames_is(made: Callable[..., Given]) -> None:
    from benchmark.score import score_row

    given, off = made("masks", 6), [0.02, *[0.0] * 8]
    rows = [a_row("masks", number, change=off if number == 0 else np.zeros(9)) for number in range(5)]
    doubted = a_row("masks", 5, "doubtful", off)
    assert score_row("a", "masks", [scores_of(given, [*rows, doubted])])["recordings wrong"] == 0
    assert score_row("a", "masks", [scores_of(given, [*rows[:4], doubted])])["recordings wrong"] == 1


def test_base_is_compared_with_the_true_one(made: Callable[..., Given]) -> None:
    from benchmark.score import score_row

    given = made("base", 2)
    change = [0.001, 0, 0, 0, 0, np.deg2rad(1)]
    near = scores_of(given, [a_row("base", "base", change=change, covariance=np.eye(6))])
    assert near.root_mm == pytest.approx([1])
    assert near.squares[0][1] == 6
    (base,) = near.frames
    assert (base.error_mm, base.rotation_deg, base.wrong) == (pytest.approx(1), pytest.approx(1), False)
    turned = scores_of(given, [a_row("base", "base", change=[0, 0, 0, 0, 0, np.deg2rad(2.5)])])
    assert score_row("a", "base", [turned])["ok and wrong"] == 1
    assert scores_of(given, []).frames[0].error_mm == 1000


def test_ranks_are_those_of_the_median_error() -> None:
    from benchmark.score import ranked

    rows = [
        {"task": task, "method": name, "error, mm": error}
        for task, name, error in (("masks", "a", 2.0), ("frame", "a", 1.0), ("masks", "b", 1.0), ("masks", "c", 1.0))
    ]
    assert [(row["task"], row["method"], row["rank"]) for row in ranked(rows)] == [
        ("masks", "b", 1),
        ("masks", "c", 1),
        ("masks", "a", 3),
        ("frame", "a", 1),
    ]


# submissions


def test_submission_is_read_as_written(made: Callable[..., Given], tmp_path: Path) -> None:
    from benchmark.score import score_submission
    from benchmark.submission import Row, read_submission, write_submission

    given = made("frame", 2)
    matrix = np.diag(np.arange(1.0, 10)) * 1e-4 + 1e-5
    rows = [
        a_row("frame", 0, change=[1e-3, *[0.0] * 8], covariance=matrix),
        replace(a_row("frame", 1, std=np.arange(1.0, 10) * 1e-3), seconds=0.25),
        Row("base", 4, "base", "failed"),
    ]
    write_submission(tmp_path / "a.csv", rows)
    read = read_submission(tmp_path / "a.csv")
    assert [*read] == [("frame", 4, "0000"), ("frame", 4, "0001"), ("base", 4, "base")]
    first, second, base = read.values()
    assert first.pose == pytest.approx(rows[0].pose, abs=1e-8)
    assert first.covariance == pytest.approx(matrix)
    assert first.stated_std == pytest.approx(np.sqrt(np.diag(matrix)))
    assert (second.std, second.seconds) == (pytest.approx(rows[1].std), 0.25)
    assert second.joints == pytest.approx(JOINTS)
    assert base.pose is None
    givens = [given, replace(given, task="base")]
    by_task = score_submission(givens, read)
    assert {task: len(scores[0].frames) for task, scores in by_task.items()} == {"frame": 2, "base": 1}
    with pytest.raises(InputError, match="world: expected one of those drawn for the task base, got 4"):
        score_submission([given], read)
    with pytest.raises(InputError, match="frame: expected one of 0000 to 0001, got 0007"):
        score_submission([given], {("frame", 4, "0007"): a_row("frame", 7)})


@pytest.mark.parametrize(
    ("column", "cell", "said"),
    [
        ("task", "tips", "task: expected one of frame, session, eyes, base, masks, images, got 'tips'"),
        ("status", "good", "status: expected one of ok, doubtful, failed, got 'good'"),
        ("world", "-1", "world: expected a number of the table, got '-1'"),
        ("tx", "far", "tx: expected a finite number, got 'far'"),
        ("qw", "3", "qx: expected a quaternion of length 1"),
        ("jaw", "", "jaw: expected a finite number, got ''"),
        ("std_tx", "0", "std_tx: expected positive standard deviations, got 0"),
        ("covariance", "1 2 3", "covariance: expected standard deviations or a covariance, got both"),
        ("seconds", "inf", "seconds: expected a finite number in seconds, got 'inf'"),
    ],
)
def test_wrong_cells_are_refused(tmp_path: Path, column: str, cell: str, said: str) -> None:
    from benchmark.submission import read_submission, write_submission

    path = tmp_path / "a.csv"
    write_submission(path, [a_row("frame", 0, std=np.ones(9))])
    header, line = path.read_text().splitlines()
    cells = dict(zip(header.split(","), line.split(","), strict=True)) | {column: cell}
    path.write_text(f"{header}\n{','.join(cells.values())}\n")
    with pytest.raises(InputError) as refused:
        read_submission(path)
    assert str(refused.value).startswith(f"{path}: line 2: {said}")


@pytest.mark.parametrize(
    ("matrix", "said"),
    [("1 2 3", "expected 45 numbers, got 3"), (" ".join(["1"] * 45), "expected a positive definite matrix")],
)
def test_wrong_covariances_and_repeated_rows_are_refused(tmp_path: Path, matrix: str, said: str) -> None:
    from benchmark.submission import read_submission, write_submission

    path = tmp_path / "a.csv"
    write_submission(path, [a_row("frame", 0, covariance=np.eye(9))])
    text = path.read_text()
    path.write_text(text.replace(" ".join(f"{value:g}" for value in np.eye(9)[np.triu_indices(9)]), matrix))
    with pytest.raises(InputError, match=said):
        read_submission(path)
    path.write_text(text + text.splitlines()[1] + "\n")
    with pytest.raises(InputError, match="line 3: expected each frame once"):
        read_submission(path)
    path.write_text(text.replace("wrist_yaw", "wrist_turn", 1))
    with pytest.raises(InputError, match="header: expected a column wrist_yaw"):
        read_submission(path)


# what is given


def test_given_folders_have_no_truth(tmp_path: Path) -> None:
    from benchmark.tasks import given_task, readings_of, set_name, table

    world, counts = table()[8], {"session": 1, "recording": 2}
    given = given_task(tmp_path, "images", world, 5, counts)
    names = {path.name for path in given.given.path.iterdir()}
    assert names == {"images", "images.csv", "camera.yaml", "joints.csv", "session.toml", "boxes.csv"}
    mask = read_mask(given.drawn.path / "masks" / "0000.png")
    x0, y0, x1, y1 = read_boxes(given.given.path / "boxes.csv")["0000"].box or (0, 0, 0, 0)
    v, u = np.nonzero(mask)
    assert (x0, y0, x1, y1) == (u.min(), v.min(), u.max(), v.max())
    by_masks = given_task(tmp_path, "masks", world, 5, counts)
    assert {path.name for path in by_masks.given.path.iterdir()} == names - {"boxes.csv"} | {"masks", "markers.csv"}
    assert not [path for path in (tmp_path / "given").rglob("*") if path.name in ("golden.json", "world.json")]
    instrument = load_instrument("lnd")
    read = readings_of(by_masks.given, instrument)
    assert (read.outer.shape, read.joints.shape) == ((2, len(OUTER_JOINTS)), (2, 3))
    truth = by_masks.drawn.golden()["0001"]
    assert read.joints[1] == pytest.approx([truth["joints"][name] for name in NAMES], abs=0.5)
    assert "12345678901234567890" not in set_name(12345678901234567890)


def test_markers_are_where_the_instrument_is(tmp_path: Path) -> None:
    from benchmark.tasks import given_task, table

    given = given_task(tmp_path, "frame", table()[8], 5, {"session": 2, "recording": 1})
    seen = read_detections(given.given.path / "markers.csv")
    for name in given.frames:
        mask = cv2.dilate(read_mask(given.drawn.path / "masks" / f"{name}.png").astype(np.uint8), np.ones((5, 5)))
        u, v = np.rint([*seen[name].values()]).astype(int).T
        assert 4 <= len(u) < 12  # those on the far side are hidden
        assert mask[v, u].mean() > 0.8


def test_right_eye_sees_the_instrument_from_its_place(tmp_path: Path) -> None:
    from benchmark.tasks import given_task, table

    given = given_task(tmp_path, "eyes", table()[8], 5, {"session": 1, "recording": 1})
    session = read_session(given.given.path)
    assert [path.name for path in (tmp_path / "given").rglob("golden.json")] == []
    truth = given.drawn.golden()["0000"]
    body = prepare("lnd")
    masks = []
    for side, view in zip(("left", "right"), session.rig.views, strict=True):
        pose = view.view_from_camera @ np.array(truth["T_camera_roll_link"])
        seen = Renderer(body, view.camera).masks(pose, truth["joints"])
        masks.append(read_mask(given.given.path / "masks" / side / "0000.png"))
        assert (seen & masks[-1]).sum() > 0.85 * (seen | masks[-1]).sum()
    left, right = (np.nonzero(mask)[1].mean() for mask in masks)
    assert right < left - 1


def test_run_scores_baselines_and_continues(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    small = ("--numbers", 8, "--session-frames", 2, "--recording-frames", 3, "--workers", 1, "--json")
    command = ("run", tmp_path, "--methods", "pnp,particles", "--tasks", "base,masks", *small)
    report = run_here("run_benchmark", *command).result
    rows = {(row["task"], row["method"]): row for row in report["table"]}
    assert {*rows} == {("base", "pnp"), ("masks", "pnp"), ("masks", "particles")}
    assert rows["masks", "particles"]["error, mm"] < min(3, rows["masks", "pnp"]["error, mm"])
    assert rows["masks", "particles"]["90 % intervals"] > 0.4
    assert rows["base", "pnp"]["error, mm"] < 20
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "solved").rglob("*.csv")}
    assert len(kept) == 3
    assert run_here("run_benchmark", *command).result == report
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "solved").rglob("*.csv")} == kept
    scored = run_here("run_benchmark", "score", tmp_path, tmp_path / "particles.csv", "--tasks", "masks", *small)
    assert [row["method"] for row in scored.result["table"]] == ["particles"]
    refused = run_here("run_benchmark", "run", tmp_path, "--methods", "guess", *small)
    assert (refused.code, refused.out) == (2, "")
    assert "--methods: expected some of estimate, calibrate" in refused.err


def test_single_frame_is_estimated_as_a_row(tmp_path: Path) -> None:
    from benchmark.methods import solved
    from benchmark.tasks import given_task, table

    given = given_task(tmp_path, "frame", table()[8], 5, {"session": 1, "recording": 1})
    (row,) = solved("estimate", given, tmp_path / "out").values()
    (frame,) = scores_of(given, [row]).frames
    assert frame.error_mm < 2
    assert row.covariance is not None
    assert row.seconds is not None


def test_interrupted_command_leaves_no_failed_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmark import methods
    from benchmark.tasks import given_task, table
    from measure.accuracy.worlds import Failure

    given = given_task(tmp_path, "frame", table()[8], 5, {"session": 1, "recording": 1})
    for code, kept in ((143, False), (1, True)):
        failure = Failure("", code, "ended", "dvrk-cmaes estimate")
        monkeypatch.setattr(methods, "estimated", lambda _, failure=failure: ({}, [failure]))
        if kept:
            assert [row.status for row in methods.solved("estimate", given, tmp_path / "out").values()] == ["failed"]
        else:
            with pytest.raises(DvrkCmaesError, match="world 8, frame: interrupted"):
                methods.solved("estimate", given, tmp_path / "out")
        assert (tmp_path / "out" / "estimate-frame-1.csv").exists() == kept


def test_seeds_are_kept_with_their_digests(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    from benchmark.tasks import KEPT, digest

    path = tmp_path / "seeds.txt"
    shown = run_here("run_benchmark", "keep", path, "--json").result["SHA-256"]
    assert [row["sha256"] for row in shown] == [digest(seed) for seed in path.read_text().split()]
    assert len({row["sha256"] for row in shown}) == len(KEPT) == 3
    assert run_here("run_benchmark", "keep", path).code == 2
    assert len(path.read_text().split()) == 3


# M3T


def test_files_of_m3t_fit_together(tmp_path: Path) -> None:
    from benchmark.m3t import POSE_COLUMNS, read_poses, write_tracker
    from benchmark.tasks import given_task, table
    from worlds.motion import instrument_of

    given = given_task(tmp_path, "images", table()[8], 5, {"session": 1, "recording": 2})
    start, instrument = a_row("images", 0), instrument_of("lnd")
    path = write_tracker(tmp_path / "m3t", given, start)
    config = yaml.safe_load(path.read_text().partition("\n")[2])
    named = {entry["name"]: kind for kind, entries in config.items() for entry in entries}
    for entry in (entry for entries in config.values() for entry in entries):
        assert not entry.get("metafile_path") or (path.parent / entry["metafile_path"]).is_file()
        for key in {*entry} - {"name", "metafile_path", "use_region_checking"}:
            values = entry[key] if isinstance(entry[key], list) else [entry[key]]
            assert all(value in named for value in values), key
    assert [entry["name"] for entry in config["Link"]][-1] == "roll_link_link"  # M3T reads children first

    opened = []

    def stored(name: str) -> cv2.FileStorage:
        opened.append(cv2.FileStorage(str(path.parent / name), cv2.FILE_STORAGE_READ))  # nodes end with it
        return opened[-1]

    poses = {"roll_link_link": stored("detector.yaml").getNode("link2world_pose").mat()}
    for entry in reversed(config["Link"]):
        for child in entry.get("child_links", []):
            file = stored(f"{child}.yaml")
            free = file.getNode("free_directions")
            assert [free.at(k).real() for k in range(6)] == [0, 0, 1, 0, 0, 0]
            joint = file.getNode("joint2parent_pose").mat() @ file.getNode("body2joint_pose").mat()
            poses[child] = poses[entry["name"]] @ joint
    expected = TRUE @ instrument.forward(JOINTS)
    for link, pose in zip(instrument.links, expected, strict=True):
        assert poses[f"{link.name}_link"] == pytest.approx(pose, abs=1e-9)
        mesh = trimesh.load_mesh(path.parent / f"{link.name}.obj", process=False)
        assert mesh.bounds == pytest.approx(np.array([link.vertices.min(0), link.vertices.max(0)]), abs=1e-6)
    camera = stored("camera.yaml")
    first = f"{int(camera.getNode('load_index').real()):0{int(camera.getNode('n_leading_zeros').real())}d}.png"
    assert (path.parent / "images" / first).is_file()
    assert camera.getNode("intrinsics").getNode("f_u").real() == given.world.camera.fx

    moved_root, bent = moved(TRUE, [1e-3, 0, 0, 0.1, 0, 0]), JOINTS + 0.2
    lines = [",".join(POSE_COLUMNS)]
    for link, pose in zip(instrument.links, moved_root @ instrument.forward(bent), strict=True):
        lines.append(",".join(["0001", link.name, *(f"{value:.9f}" for value in pose[:3].ravel())]))
    poses_csv = tmp_path / "poses.csv"
    poses_csv.write_text("\n".join(lines) + "\n")
    (row,) = read_poses(poses_csv, given)
    assert row.pose == pytest.approx(moved_root, abs=1e-6)
    assert row.joints == pytest.approx(bent, abs=1e-5)
    poses_csv.write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(InputError, match="frame 0001: expected a row of the body jaw_2_link, got none"):
        read_poses(poses_csv, given)


@pytest.mark.parametrize("lens", ["barrel", "rational"])
def test_images_of_m3t_have_no_lens(lens: Any) -> None:
    from benchmark.m3t import undistorted
    from benchmark.tasks import table

    camera = replace(table()[8], size=(320, 240), lens=lens, focal=1.2).camera
    point = np.array([0.02, -0.015, 0.1])
    image = np.zeros((240, 320, 3), np.uint8)
    u, v = camera.project(point[None])[0]
    cv2.circle(image, (round(u), round(v)), 4, (255, 255, 255), -1)
    rows, columns = np.nonzero(undistorted(camera, image)[..., 0] > 127)
    straight = point[:2] / point[2] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    assert [columns.mean(), rows.mean()] == pytest.approx(straight, abs=1)
    assert np.linalg.norm(straight - [u, v]) > 0.5


# the page and the real recordings


def test_page_has_the_table_and_the_digests() -> None:
    from benchmark.pictures import figures, markdown
    from benchmark.tasks import KEPT, SEED, TASKS

    page = (ROOT / "data" / "reference" / "benchmark.md").read_text(encoding="utf-8")
    assert markdown(figures()["table"]) in page
    halves = [f"`{digest[k : k + 32]}`" for digest in KEPT for k in (0, 32)]
    assert all(value in page for value in (*halves, f"`{SEED}`", *(f"| `{task}` |" for task in TASKS)))


def test_pictures_and_table_are_written(tmp_path: Path) -> None:
    from benchmark.pictures import figures, markdown, write_page

    for name in ("reference", "docs"):
        (tmp_path / name).mkdir()
    page = tmp_path / "reference" / "benchmark.md"
    page.write_text("a\n\n| task | rank | more |\n| --- | --- | --- |\n| x | 1 | 2 |\n\nb\n")
    found = figures()
    (tmp_path / "scores.json").write_text(json.dumps(found | {"by world": []}))
    written = write_page(tmp_path / "scores.json", tmp_path)
    assert page.read_text() == f"a\n\n{markdown(found['table'])}\nb\n"
    assert figures(tmp_path) == found
    assert [path.stat().st_size > 1000 for path in written[1:3]] == [True, True]


def test_real_recordings_are_named_and_shafts_compared(tmp_path: Path, run_here: Callable[..., Ran]) -> None:
    from benchmark.anchors import shaft_report

    report = run_here("run_benchmark", "anchors", "--json").result
    assert [*report] == ["paper", "bench b", "lincoln"]
    assert all(any("put" in row for row in rows) and any("measured" in row for row in rows) for rows in report.values())
    pose = transform(exp_rotation([0, np.deg2rad(3), 0]), [0, 0.002, 0.1])
    result = {"frame": "a", "status": "ok", "camera_from_root": pose.tolist(), "joints": {}}
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "a.json").write_text(json.dumps(result))
    stereo = tmp_path / "shafts.csv"
    stereo.write_text("frame,axis_x,axis_y,axis_z,point_x_m,point_y_m,point_z_m\na,0,0,1,0,0,0.1\nb,0,0,1,0,0,0.1\n")
    (row,) = shaft_report(tmp_path, stereo)["shafts"]
    assert (row["shaft, deg"], row["distance, mm"]) == pytest.approx((3.0, 2.0))
    stereo.write_text("frame,axis_x,axis_y,axis_z,point_x_m,point_y_m,point_z_m\nb,0,0,1,0,0,0.1\n")
    with pytest.raises(InputError, match="expected results of frames in"):
        shaft_report(tmp_path, stereo)
