"""The calibration in ``session.json``: written, read back, and refused with file and field where it is damaged."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.files import write_json
from helpers.page_calibrations import OFFSETS as PAGE_OFFSETS
from helpers.page_calibrations import cables_of, solved
from helpers.page_calibrations import calibration as page_calibration
from helpers.session_worlds import make_world

from dvrk_cmaes import InputError, Lag, SessionCalibration, read_calibration
from dvrk_cmaes.calibration.blocks import BASE_AXES
from dvrk_cmaes.calibration.document import Agreement
from dvrk_cmaes.calibration.session_camera import SessionCamera
from dvrk_cmaes.calibration.session_masks import SessionMasks
from dvrk_cmaes.calibration.session_rig import ViewRotation

WORLD = make_world(4)
OFFSETS = dict(zip(("insertion", "roll", *WORLD.model.names), WORLD.truth.offsets.tolist(), strict=True))
SPREADS = {
    "yaw": 0.002,
    "pitch": 0.002,
    "insertion": 4e-4,
    "roll": 0.05,
    "wrist_pitch": 0.06,
    "wrist_yaw": 0.05,
    "jaw": 0.09,
    "slack_translation": 2e-4,
    "slack_rotation": 0.002,
}


def calibration() -> SessionCalibration:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((11, 11)) * 1e-3
    return SessionCalibration(
        instrument="lnd",
        camera_from_base=WORLD.truth.camera_from_base,
        offsets=OFFSETS,
        axes=(*BASE_AXES, *OFFSETS),
        covariance=root @ root.T,
        covariance_given_camera=root @ root.T / 4,
        spreads=SPREADS,
        frames=("0000", "0002"),
        left_out={"0001": "disagrees with the session"},
        leave_one_out={"0000": Agreement(0.93, 1.5), "0002": Agreement(0.9, 2.25)},
        iou=0.95,
        contour_px_95=2.5,
        lag=Lag(2.0, 0.25, 0.066667, 0.008),
        camera=SessionCamera(1.02, 0.01, (3.0, -4.5), (6.0, 7.0), contradicts=False, applied=True, width=640),
        masks=SessionMasks(0.4, 0.1, applied=True),
        rig=(ViewRotation("right", np.array([0.1, 0.0, 0.3]), np.array([0.01, 0.02, 0.03]), 12, applied=True),),
        undetermined=("offset of insertion",),
        doubts=("the camera file is contradicted",),
        remarks=("readings come 2 frames late",),
        arm="si",
        roll_offset=0.4162,
        seconds=12.5,
        seed=3,
        config={"seed": 3},
    )


def test_written_calibration_is_read_back(tmp_path: Path) -> None:
    before = calibration()
    write_json(tmp_path / "session.json", before.to_dict())
    after = read_calibration(tmp_path / "session.json")
    again = SessionCalibration.from_dict(after.to_dict())
    assert again.to_dict() == after.to_dict()
    assert {**after.to_dict(), "std": None} == {**before.to_dict(), "std": None}
    np.testing.assert_allclose(after.camera_from_base, before.camera_from_base, atol=1e-8)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-5)
    np.testing.assert_allclose(after.covariance_given_camera, before.covariance_given_camera, rtol=1e-5)
    for name in (
        "instrument",
        "axes",
        "frames",
        "left_out",
        "leave_one_out",
        "lag",
        "camera",
        "undetermined",
        "doubts",
        "remarks",
        "arm",
    ):
        assert getattr(after, name) == getattr(before, name)


def test_rig_is_read_back() -> None:
    before = calibration()
    (view,) = SessionCalibration.from_dict(before.to_dict()).rig
    assert (view.view, view.frames, view.applied) == ("right", 12, True)
    np.testing.assert_allclose(view.rotation_deg, before.rig[0].rotation_deg)
    document = before.to_dict()
    document["rig"][0]["frames"] = -1
    with pytest.raises(InputError, match=r"^session: rig\[0\]\.frames: expected a whole number"):
        SessionCalibration.from_dict(document)


def test_document_has_documented_fields() -> None:
    document = calibration().to_dict()
    assert {
        "schema",
        "instrument",
        "camera_from_base",
        "rcm",
        "offsets",
        "std",
        "covariance",
        "frames",
        "left_out",
        "leave_one_out",
        "lag",
        "camera",
        "seconds",
        "seed",
        "version",
        "config",
    } <= set(document)
    assert document["schema"] == 3
    assert document["rcm"] == [row[3] for row in document["camera_from_base"][:3]]
    assert document["left_out"] == {"0001": "disagrees with the session"}
    assert document["leave_one_out"]["0002"] == {"iou": 0.9, "contour_px": 2.25}
    assert document["covariance"]["axes"] == ["tx", "ty", "tz", "rx", "ry", "rz", *OFFSETS]
    variance = np.diag(document["covariance"]["matrix"])
    np.testing.assert_allclose(document["std"]["base_translation_mm"], 1e3 * np.sqrt(variance[:3]), rtol=1e-5)
    np.testing.assert_allclose(document["std"]["base_rotation_deg"], np.degrees(np.sqrt(variance[3:6])), rtol=1e-5)
    assert list(document["std"]["offsets"]) == list(document["offsets"])


Damage = Callable[[dict[str, Any]], None]


def put(*path: str, value: object) -> Damage:
    def damage(document: dict[str, Any]) -> None:
        inner = document
        for name in path[:-1]:
            inner = inner[name]
        inner[path[-1]] = value

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (put("camera_from_base", value=None), "camera_from_base: expected 4 rows of 4 finite numbers, got nothing"),
        (
            put("camera_from_base", value=[[1, 0, 0, 0]] * 4),
            "camera_from_base: expected a rotation and a translation over 0 0 0 1, "
            "got [[1, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]]",
        ),
        (put("offsets", "jaw", value="far"), "offsets.jaw: expected a finite number, got 'far'"),
        (put("offsets", value=None), "offsets: expected an object, got nothing"),
        (
            put("covariance", "matrix", value=[[1.0]]),
            "covariance.matrix: expected 11 rows of 11 finite numbers, no negative variance, got [[1.0]]",
        ),
        (
            put("covariance", "given_camera", value=[[1.0]]),
            "covariance.given_camera: expected 11 rows of 11 finite numbers, no negative variance, got [[1.0]]",
        ),
        (
            put("covariance", "matrix", value=None),
            "covariance.matrix: expected 11 rows of 11 finite numbers, no negative variance, got nothing",
        ),
        (
            put("covariance", "axes", value=["tx"]),
            "covariance.axes: expected tx, ty, tz, rx, ry, rz, insertion, roll, wrist_pitch, wrist_yaw, jaw, "
            "got ['tx']",
        ),
        (put("schema", value=2), "schema: expected 3, got 2; calibrate again: dvrk-cmaes calibrate FOLDER"),
        (put("schema", value=None), "schema: expected 3, got none; calibrate again: dvrk-cmaes calibrate FOLDER"),
        (put("lag", value={"applied": True}), "lag: expected frames or seconds, got {'applied': True}"),
        (put("spreads", "roll", value=0.0), "spreads.roll: expected a number above 0, got 0.0"),
        (put("covariance", value=[]), "covariance: expected an object, got []"),
        (put("spreads", value=None), "spreads: expected an object, got nothing"),
        (put("iou", value="high"), "iou: expected a finite number, got 'high'"),
        (put("arm", value="xi"), "arm: expected one of si, classic, got 'xi'"),
        (put("left_out", value=["0001"]), "left_out: expected an object, got ['0001']"),
        (put("leave_one_out", "0000", value=1), "leave_one_out.0000: expected an object, got 1"),
        (put("frames", value="0000"), "frames: expected a list of texts, got '0000'"),
        (put("seed", value=-1), "seed: expected a whole number of at least 0, got -1"),
        (put("config", value=[1]), "config: expected an object, got [1]"),
    ],
)
def test_error_names_file_and_field(tmp_path: Path, damage: Damage, message: str) -> None:
    document = calibration().to_dict()
    damage(document)
    path = tmp_path / "session.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_calibration(path)
    assert str(caught.value) == f"{path}: {message}"


def test_negative_variance_is_refused(tmp_path: Path) -> None:
    document = calibration().to_dict()
    document["covariance"]["matrix"][2][2] = -1.0
    with pytest.raises(InputError, match=r"covariance\.matrix: expected .*no negative variance"):
        SessionCalibration.from_dict(document, where="session.json")


def test_read_calibration_predicts_other_frames() -> None:
    model, found = calibration().model(WORLD.model.outer, WORLD.model.joints, WORLD.model.names)
    np.testing.assert_allclose(found.offsets, WORLD.truth.offsets)
    at = model.predict(found)
    np.testing.assert_allclose(at.joints, WORLD.model.joints + WORLD.truth.offsets[2:])
    # the si arm's poses are shifted by 51 mm along the same shafts
    np.testing.assert_allclose(at.minus(WORLD.model.predict(WORLD.truth))[:, [0, 1, 3, 4, 5]], 0, atol=1e-9)
    np.testing.assert_allclose(model.deviations.joints, [0.06, 0.05, 0.09])
    np.testing.assert_allclose(model.deviations.slack, [2e-4] * 3 + [0.002] * 3)


def test_calibration_with_other_joints_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        calibration().model(WORLD.model.outer, WORLD.model.joints[:, :1], ("wrist_pitch",))
    assert str(caught.value) == (
        "session: offsets: expected those of insertion, roll, wrist_pitch, "
        "got insertion, roll, wrist_pitch, wrist_yaw, jaw"
    )


def test_cables_survive_the_document_and_correct_frames_by_their_readings_alone() -> None:
    frames = solved(("a", "b"))
    before = page_calibration(frames, cables=cables_of())
    after = SessionCalibration.from_dict(json.loads(json.dumps(before.to_dict())))
    assert after.to_dict()["cables"] == before.to_dict()["cables"]
    readings = np.array([[0.0, 0.0, 0.12, 0.5]]), np.array([[0.1, 0.4, 0.0]])
    model, constants = after.model(*readings, ("wrist_pitch", "wrist_yaw", "jaw"))
    joints = model.predict(constants).joints[0]
    np.testing.assert_allclose(joints[0], 0.1 + PAGE_OFFSETS["wrist_pitch"] + 0.25 * 0.4)
    np.testing.assert_allclose(model.deviations.joints, 0.05)


@pytest.mark.parametrize(
    ("field", "value"), [("coupling", [[0.0]]), ("width", [0.1]), ("seconds", [0.0] * 4), ("joints", ["roll"])]
)
def test_cables_of_another_number_of_joints_are_refused(field: str, value: object) -> None:
    frames = solved(("a", "b"))
    document = page_calibration(frames, cables=cables_of()).to_dict()
    document["cables"][field] = value
    with pytest.raises(InputError, match=r"^session\.json: cables"):
        SessionCalibration.from_dict(document, where="session.json")
