"""The dVRK's descriptions of tools and arms: reading with comments, and their effects."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from helpers.places import bundled_path
from helpers.waiting import within

from dvrk_cmaes import Body, EstimateConfig, InputError, estimate, load_instrument, read_frame, read_session
from dvrk_cmaes.config import SearchConfig
from dvrk_cmaes.instrument.arm import ROLL_OFFSET_LONG, base_from_root
from dvrk_cmaes.instrument.dvrk_description import read_tool
from dvrk_cmaes.instrument.tool import with_tool
from dvrk_cmaes.io.json_file import read_json_object
from dvrk_cmaes.joints.prior import LIMIT_SIGMA

TOOL = """\
/* a tool // with comments */
{
    "DH": {
        "convention": "modified", // see "manual"
        "joints": [
            {"name": "roll", "alpha": 0.0, "A": 0.0, "theta": 0.0, "D": 0.467, "type": "revolute", "mode": "active",
             "offset": 0.0, "qmin": -1.0, "qmax": 1.0, "ftmax": 0.33},
            {"name": "wrist_pitch", "alpha": -1.5708, "A": 0.0, "theta": 0.0, "D": 0.0, "type": "revolute",
             "offset": -1.5708, "qmin": -1.2, "qmax": 1.2},
            {"name": "wrist_yaw", "alpha": -1.5708, "A": 0.0091, "theta": 0.0, "D": 0.0, "type": "revolute",
             "offset": -1.5708, "qmin": -1.3, "qmax": 1.3}
        ]
    },
    "jaw": {"qmin": -0.7, /* -40 */ "qmax": 1.4}
}
"""


def written(folder: Path, text: str = TOOL) -> Path:
    path = folder / "TOOL.json"
    path.write_text(text, encoding="utf-8")
    return path


def test_tool_limits_replace_urdf_limits(tmp_path: Path) -> None:
    plain = load_instrument("lnd")
    assert plain.limits_from == "URDF"
    tooled = with_tool(plain, read_tool(written(tmp_path)))
    assert tooled.limits.tolist() == [[-1.2, 1.2], [-1.3, 1.3], [-0.7, 1.4]]
    assert (tooled.limits_from, tooled.roll_offset, tooled.roll_limits) == ("TOOL.json", 0.467, (-1, 1))
    assert plain.limits[0].tolist() != [-1.2, 1.2]


def test_tool_limits_bound_search_and_give_warning(tmp_path: Path) -> None:
    session = read_session(bundled_path("demo"))
    data = read_frame(session.frames[0], session.camera)
    readings = {**session.frames[0].readings, "roll": 1.1}
    narrow = TOOL.replace('"qmin": -1.2, "qmax": 1.2', '"qmin": -0.6, "qmax": 0.6')
    body = Body.prepare(with_tool(load_instrument("lnd"), read_tool(written(tmp_path, narrow))))
    quick = EstimateConfig(search=SearchConfig(samples=128, starts=2, evaluations=160))
    found = estimate(data.mask, data.camera, readings, body, config=quick)
    assert found.readings == readings
    assert found.joints["wrist_pitch"] < 0.6 + 2 * LIMIT_SIGMA < readings["wrist_pitch"]
    assert found.warnings == (
        "reading of wrist_pitch: 47.3 deg is outside its limits, -34.4 to 34.4 deg",
        "reading of roll: 63.0 deg is outside its limits, -57.3 to 57.3 deg",
    )
    assert found.config["instrument"] == {
        "limits_from": "TOOL.json",
        "limits": {"wrist_pitch": [-0.6, 0.6], "wrist_yaw": [-1.3, 1.3], "jaw": [-0.7, 1.4]},
        "arm": "classic",
        "roll_offset": 0.467,
    }
    assert found.camera_from_root is not None
    assert found.camera_from_base is not None
    reached = np.linalg.inv(found.camera_from_base) @ found.camera_from_root
    np.testing.assert_allclose(reached, base_from_root(readings, roll_offset=ROLL_OFFSET_LONG), atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"convention": "modified"', '"convention": "standard"', "DH.convention: expected modified, got 'standard'"),
        ('"name": "roll"', '"name": "rol"', "DH.joints: expected roll, wrist_pitch, wrist_yaw of a dVRK tool "),
        (
            '"alpha": 0.0,',
            '"alpha": 0.1,',
            "DH.joints: roll: expected a revolute joint of alpha, A, theta and offset 0",
        ),
        ('"D": 0.467', '"D": "long"', "DH.joints[0].D: expected a finite number, got 'long'"),
        ('"qmax": 1.2', '"qmax": -1.3', "DH.joints[1].qmax: expected at least qmin, -1.2, got -1.3"),
        (
            '"type": "revolute"',
            '"type": "screw"',
            "DH.joints[0].type: expected one of revolute, prismatic, got 'screw'",
        ),
        ('"DH"', '"dh"', "DH: expected an object, got nothing"),
        ("{", "", "expected a dVRK tool description (JSON), got no valid JSON (Extra data: line 3 column 9 "),
        ("*/", "", "expected a dVRK tool description (JSON), got no valid JSON (Extra data: line 14 "),
    ],
)
def test_unusable_description_is_refused(tmp_path: Path, old: str, new: str, expected: str) -> None:
    path = written(tmp_path, TOOL.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_tool(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{path}: {expected}")


def test_comments_are_removed_quickly(tmp_path: Path) -> None:
    path = written(tmp_path, '{"a": "http://x/*y*/ \\" // z", "b": 1 /* " */}')
    assert read_json_object(path, expected="x", comments=True) == {"a": 'http://x/*y*/ " // z', "b": 1}
    for text in ("/*" * 200_000, '"\\"' * 100_000, "//" * 200_000):
        with within(5, time.process_time), pytest.raises(InputError, match="got no valid JSON"):
            read_json_object(written(tmp_path, text), expected="x", comments=True)
