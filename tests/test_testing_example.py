"""An example of a user's own test: a frame of the bundled session against its golden pose."""

from pathlib import Path

from dvrk_cmaes import estimate, prepare
from dvrk_cmaes.frames.frame import read_frame
from dvrk_cmaes.frames.session_folder import read_session
from dvrk_cmaes.testing import assert_pose_close

SESSION = Path(__file__).parents[1] / "data" / "demo"  # with a golden.json


def test_pose_is_unchanged() -> None:
    session, body = read_session(SESSION), prepare("lnd")
    files = session.frames[1]
    frame = read_frame(files, session.camera)
    result = estimate(frame.mask, frame.camera, files.readings, body, frame=files.name)
    golden = session.truth.frames[files.name]
    assert_pose_close(result, golden, instrument=body.instrument, root_mm=2, tip_mm=2, shaft_deg=5)
