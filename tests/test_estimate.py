"""``estimate`` as a library function: the result, its reproducibility, the use of evidence, and refused input."""

from __future__ import annotations

import builtins
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.places import bundled_path
from helpers.transforms import rotation_angle
from scipy.spatial.transform import Rotation

from dvrk_cmaes import (
    Body,
    Camera,
    DvrkCmaesError,
    EstimateConfig,
    FrameData,
    Renderer,
    Result,
    Session,
    estimate,
    load_instrument,
    read_frame,
    read_session,
)
from dvrk_cmaes.camera.fields import WRONG
from dvrk_cmaes.config import CameraConfig
from dvrk_cmaes.evidence.gather import Evidence
from dvrk_cmaes.joints.prior import Readings
from dvrk_cmaes.pose import find_pose
from dvrk_cmaes.pose.search import METHODS as SEARCHES
from dvrk_cmaes.pose.search.starts import PoseCandidate

QUICK = EstimateConfig()
QUICK = replace(QUICK, search=replace(QUICK.search, samples=128, starts=3, evaluations=200))


@pytest.fixture(scope="module")
def session() -> Session:
    return read_session(bundled_path("demo"))


@pytest.fixture(scope="module")
def frame(session: Session) -> FrameData:
    return read_frame(session.frames[0], session.camera)


@pytest.fixture(scope="module")
def readings(session: Session) -> dict[str, float]:
    return dict(session.frames[0].readings)


@pytest.fixture(scope="module")
def quick_result(bundled_body: Body, frame: FrameData, readings: dict[str, float]) -> Result:
    return estimate(frame.mask, frame.camera, readings, bundled_body, config=QUICK)


def test_covariance_of_a_tip_is_that_of_pose_and_joints_carried_to_it_in_the_cameras_axes(
    bundled_body: Body, frame: FrameData, readings: dict[str, float]
) -> None:
    exact = CameraConfig(1e-6, 1e-6, 1e-6, 1e-6, 1e-6)
    result = estimate(frame.mask, frame.camera, readings, bundled_body, config=replace(QUICK, camera=exact))
    assert result.covariance is not None
    assert result.expected_error is not None
    turned = result.covariance_in_camera()
    moves = np.random.default_rng(0).multivariate_normal(np.zeros(9), 1e-4 * turned, 20_000)
    tips = bundled_body.instrument.ends(np.array([*result.joints.values()]) + moves[:, 6:])[:, 0]
    pose = result.require_pose()
    around = Rotation.from_rotvec(moves[:, 3:6]).apply(tips @ pose[:3, :3].T)
    sampled = np.cov((1e5 * (around + moves[:, :3])).T)  # mm, of changes 100 times as small
    np.testing.assert_allclose(
        result.expected_error.tip_covariance_mm2["jaw_1"], sampled, atol=0.03 * np.trace(sampled)
    )
    again = Result.from_dict(result.to_dict()).expected_error
    assert again is not None
    np.testing.assert_allclose(again.tip_axes_mm["mean"] ** 2, np.diag(again.tip_covariance_mm2["mean"]), rtol=1e-5)


def answer(result: Result) -> str:
    """Give a result as text, without its seconds and number of threads."""
    document = json.loads(json.dumps(result.to_dict()))
    del document["seconds"], document["config"]["threads"]
    return json.dumps(document)


# the result


def test_known_mistake_of_the_camera_file_makes_a_result_doubtful(
    quick_result: Result, bundled_body: Body, frame: FrameData, readings: dict[str, float]
) -> None:
    remarks = ("camera file: unusual", f"{WRONG}fx 800 and fy 920 are 13 % apart")
    camera = replace(frame.camera, remarks=remarks)
    result = estimate(frame.mask, camera, readings, bundled_body, config=QUICK)
    assert result.status == "doubtful"
    assert result.reasons == (remarks[1], *quick_result.reasons)
    assert result.remarks == remarks


def test_mirror_twin_is_alternative_farther_from_readings(quick_result: Result, bundled_body: Body) -> None:
    twins = [other for other in quick_result.alternatives if other.relation == "mirror twin"]
    assert len(twins) == 1
    assert quick_result.camera_from_root is not None
    expected, _ = bundled_body.instrument.twin(quick_result.camera_from_root, list(quick_result.joints.values()))
    assert np.rad2deg(rotation_angle(twins[0].camera_from_root, expected)) < 40
    assert twins[0].reading_distance_deg is not None
    assert twins[0].reading_distance_deg > 30


# reproducibility


def test_another_search_follows_where_the_first_does_not_explain_the_mask(
    bundled_body: Body, frame: FrameData, readings: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = estimate(frame.mask, frame.camera, readings, bundled_body)
    seeds, search = [], find_pose.find_candidates

    def poor_at_first(
        renderer: Renderer, evidence: Evidence, known: Readings, config: EstimateConfig
    ) -> tuple[list[PoseCandidate], list[Renderer]]:
        seeds.append(config.seed)
        found, drawing = search(renderer, evidence, known, config)
        if len(seeds) == 1:
            found = [replace(each, at=each.at.moved(np.r_[0.0, 0.08, 0.0, np.zeros(6)])) for each in found]
        return found, drawing

    monkeypatch.setattr(find_pose, "find_candidates", poor_at_first)
    found = estimate(frame.mask, frame.camera, readings, bundled_body, config=EstimateConfig(seed=2**32 - 1))
    assert len(set(seeds)) == 2
    assert found.status == usual.status == "ok"
    assert found.evaluations > 1.5 * usual.evaluations
    np.testing.assert_allclose(found.camera_from_root, usual.camera_from_root, atol=1e-3)
    estimate(frame.mask, frame.camera, readings, bundled_body)
    assert len(seeds) == 3  # once is enough


def test_no_file_is_opened(
    bundled_body: Body,
    frame: FrameData,
    readings: dict[str, float],
    quick_result: Result,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*arguments: object, **_: object) -> None:
        raise AssertionError(f"opened {arguments}")

    monkeypatch.setattr(builtins, "open", refuse)
    assert answer(estimate(frame.mask, frame.camera, readings, bundled_body, config=QUICK)) == answer(quick_result)


def test_arguments_are_not_modified(bundled_body: Body, frame: FrameData, readings: dict[str, float]) -> None:
    mask, given = frame.mask.copy(), dict(readings)
    ignore = np.zeros_like(mask)
    tips = np.array([[100.0, 200.0], [110.0, 190.0]])
    before = tips.copy()
    estimate(mask, frame.camera, given, bundled_body, ignore=ignore, keypoints=tips, config=QUICK)
    assert (mask == frame.mask).all()
    assert given == readings
    assert not ignore.any()
    assert (tips == before).all()


# methods


@pytest.mark.parametrize("method", SEARCHES)
def test_every_search_method_runs(
    bundled_body: Body, frame: FrameData, readings: dict[str, float], method: str
) -> None:
    config = replace(QUICK, search=replace(QUICK.search, method=method))
    result = estimate(frame.mask, frame.camera, readings, bundled_body, config=config)
    assert result.config["search"]["method"] == method
    assert result.quality is not None
    assert result.quality.iou > 0.9


def test_rays_cmaes_and_differences_together_give_the_pose_of_the_closed_form(
    bundled_body: Body, frame: FrameData, readings: dict[str, float]
) -> None:
    closed = EstimateConfig()
    card = replace(closed, refine=replace(closed.refine, derivatives="differences"))
    assert (card.silhouette.method, card.search.method) == ("rays", "cmaes")
    found, usual = (estimate(frame.mask, frame.camera, readings, bundled_body, config=each) for each in (card, closed))
    assert found.status == usual.status == "ok"
    assert found.rays > 50_000
    assert found.evaluations > usual.evaluations + 500
    np.testing.assert_allclose(found.camera_from_root[:3, 3], usual.camera_from_root[:3, 3], atol=1e-4)
    assert rotation_angle(found.camera_from_root, usual.camera_from_root) < np.deg2rad(0.5)


@pytest.mark.parametrize("field", ["fmm", "exact", "chamfer"])
def test_every_distance_field_method_runs(
    bundled_body: Body, frame: FrameData, readings: dict[str, float], field: str
) -> None:
    result = estimate(frame.mask, frame.camera, readings, bundled_body, config=replace(QUICK, distance_field=field))
    assert result.quality is not None
    assert result.quality.iou > 0.93


def test_hook_without_jaws_is_estimated(shared: Any) -> None:
    hook = Body.prepare(load_instrument(shared / "instruments" / "dvrk_model" / "urdf" / "instrument_400183.urdf"))
    instrument = hook.instrument
    camera = Camera(640, 480, 1030.0, 1030.0, 318.2, 243.7)
    pose = np.array(
        [[-0.64, -0.41, -0.65, -0.008], [0.06, -0.87, 0.48, -0.013], [-0.77, 0.27, 0.58, 0.124], [0, 0, 0, 1.0]]
    )
    pose[:3, :3] = np.linalg.svd(pose[:3, :3])[0] @ np.linalg.svd(pose[:3, :3])[2]
    joints = np.array([0.3, -0.2, 0.0])[: len(instrument.joint_names)]
    mask = Renderer(hook, camera).masks(pose[None], joints[None])[0]
    result = estimate(mask, camera, dict(zip(instrument.joint_names, joints + 0.05, strict=True)), hook)
    assert any("no pair of jaws" in text for text in result.unused)
    assert result.quality is not None
    assert result.quality.iou > 0.97
    assert result.covariance is not None
    assert np.isfinite(result.covariance).all()


# refused input


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"ignore": np.zeros((240, 320), bool)}, "ignore: expected 640 x 480"),
        ({"keypoints": [1.0, 2.0, 3.0]}, "keypoints: expected"),
        ({"keypoints": [[1.0, 2.0], [3.0, float("nan")]]}, "keypoints: expected"),
        ({"arm": "sii", "joints": {"yaw": 0.1, "pitch": 0.1, "insertion": 0.1, "roll": 0.1}}, "arm: expected si"),
    ],
)
def test_invalid_options_are_refused(
    bundled_body: Body, frame: FrameData, changes: dict[str, Any], expected: str
) -> None:
    given: dict[str, Any] = {"mask": frame.mask, "camera": frame.camera, "instrument": bundled_body, "config": QUICK}
    with pytest.raises(DvrkCmaesError) as caught:
        estimate(**{**given, **changes})
    assert str(caught.value).startswith(expected)


def test_few_pixels_at_the_border_give_a_result_that_can_be_read_again(shared: Any) -> None:
    """A mode that would need the instrument to be kilometres away is left out."""
    mask = np.zeros((480, 640), dtype=np.bool_)
    mask[229:245, 639] = mask[233:242, 638] = mask[233:238, 637] = True
    urdf = shared / "instruments" / "lnd_400006" / "lnd_400006.urdf"
    joints = {"wrist_pitch": -0.808748, "wrist_yaw": 0.14219, "jaw": 0.406995}
    result = estimate(mask, Camera(640, 480, fx=948.4, fy=944.9, cx=330.0, cy=212.6), joints, urdf)
    assert result.status == "doubtful"
    assert Result.from_dict(result.to_dict()).reasons == result.reasons
