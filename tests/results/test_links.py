"""Poses of links from a result: they agree with the instrument's kinematics, and an unknown instrument is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.canned_results import canned, failed
from helpers.places import bundled_path

from dvrk_cmaes import Body, InputError, estimate, read_frame, read_result, read_session


def test_estimated_result_knows_its_links(bundled_body: Body, tmp_path: Path) -> None:
    session = read_session(bundled_path("demo"))
    files = session.frames[1]
    frame = read_frame(files, session.camera)
    result = estimate(frame.mask, frame.camera, files.readings, bundled_body, frame=files.name, time=12.5)
    links = result.links()
    assert list(links) == [link.name for link in bundled_body.instrument.links]
    np.testing.assert_allclose(links["roll_link"], result.camera_from_root)
    for tip, place in zip(bundled_body.instrument.jaw_tips, result.tips, strict=True):
        pose = links[bundled_body.instrument.links[tip.link].name]
        np.testing.assert_allclose(pose[:3, :3] @ tip.position + pose[:3, 3], place)
    (tmp_path / "0001.json").write_text(json.dumps(result.to_dict()))
    again = read_result(tmp_path / "0001.json")
    assert again.time == 12.5
    for name, pose in again.links(bundled_body.instrument).items():
        np.testing.assert_allclose(pose, links[name], atol=1e-7)


def test_instrument_is_needed_for_result_of_file() -> None:
    with pytest.raises(InputError, match=r"^links: expected the instrument of a result that was read from a file"):
        canned("a").links()


def test_missing_joint_is_named(bundled_body: Body) -> None:
    less = replace(canned("a"), joints={"wrist_pitch": 0.1, "jaw": 0.2})
    with pytest.raises(InputError, match=r"^links: joints: expected a value of wrist_yaw of .*, got wrist_pitch, jaw$"):
        less.links(bundled_body.instrument)


def test_frame_without_pose_has_no_links() -> None:
    assert failed("a").links() == {}
