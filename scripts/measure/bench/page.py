"""Size of the page of a long recording, and how long a real browser takes to load it."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.report.track_page import FollowedRecording, TrackPictures, chosen_frames, write_track_page
from dvrk_cmaes.results.tracked import TrackView
from dvrk_cmaes.silhouette.prepare import prepare
from dvrk_cmaes.synth.levels import LEVELS
from dvrk_cmaes.synth.moving_arm import FRAMES_A_SECOND, MOTION_LEVELS, moving_arm
from dvrk_cmaes.synth.moving_images import IMAGE_LEVELS, DrawnTool, RecordingImages
from dvrk_cmaes.synth.session import default_camera
from dvrk_cmaes.synth.truth import exact_coverage

_DRAWN: Final = 12  # images that are drawn; the pictures repeat them
_LOAD: Final = "return performance.getEntriesByType('navigation')[0].loadEventEnd"


def page_report(frames: int, repeats: int) -> dict[str, Any]:
    """Write the page of a made recording, and open it in Chromium several times.

    Raises
    ------
    DvrkCmaesError
        Chromium or chromedriver is not installed.
    """
    recording = made_recording(frames)
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        path = write_track_page(Path(folder), recording)
        row: dict[str, Any] = {"frames": frames, "pictures": len(recording.pictures), "MB": path.stat().st_size / 1e6}
        row["written, s CPU"] = time.process_time() - began
        with chromium(Path(folder) / "profile") as browser:
            loads = [load(browser, path) for _ in range(repeats)]
            row |= {"loaded, s, median": float(np.median(loads)), "worst": max(loads)}
    return {"page of a recording": [row]}


def made_recording(frames: int) -> FollowedRecording:
    """Make a recording as if it was followed: smooth motion, residuals with noise, a loss in about every 300 frames."""
    body, camera, rng = prepare("lnd"), default_camera(LEVELS["easy"]), np.random.default_rng(0)
    _, truths, _ = moving_arm(body, camera, rng, min(frames, 300), MOTION_LEVELS["easy"])
    lost = np.repeat(rng.random(-(-frames // 10)) < 1 / 30, 10)[:frames]
    rows = []
    for k in range(frames):
        truth = truths[k % len(truths)]
        joints = {name: value + 0.002 * rng.standard_normal() for name, value in truth.joints.items()}
        rows.append(
            {
                "frame": f"{k:06d}",
                "time": k / FRAMES_A_SECOND,
                "status": "lost" if lost[k] else "ok" if k % 11 else "doubtful",
                "reasons": ["lost: the mask's edges do not support the predicted outline"] if lost[k] else [],
                "camera_from_root": truth.camera_from_root.tolist(),
                "joints": joints,
                "std": {"tip_mm": 0.5 + 0.1 * rng.random()},
                "offsets": {name: 0.05 * rng.standard_normal() for name in ("roll", *joints)},
                "tips": (truth.tips + 1e-4 * rng.standard_normal(3)).tolist(),
                "seconds": 0.03 + 0.01 * rng.random(),
                "searched": False,
                "residual_px": 0.8 + 0.2 * rng.random(),
            }
        )
    pictures = TrackPictures(rows)
    images = RecordingImages(camera, IMAGE_LEVELS["easy"], (0,), 1 / FRAMES_A_SECOND)
    drawn = []
    for k in np.linspace(0, len(truths) - 1, min(_DRAWN, frames)).astype(int).tolist():
        coverage = exact_coverage(body, camera, truths[k])
        drawn.append((images.draw(k, [DrawnTool(truths, coverage)]), coverage > 0.5))
    for number in chosen_frames(rows):
        image, mask = drawn[number % len(drawn)]
        pictures.add(number, [TrackView(image, mask, mask, (camera.width, camera.height))])
    overlaps = 1 - 0.02 * np.abs(rng.standard_normal(frames))
    read = {name: np.array([row["joints"][name] for row in rows]) - 0.1 for name in rows[0]["joints"]}
    return FollowedRecording(rows, "made", "lnd", None, read, overlaps, pictures.pictures)


@contextmanager
def chromium(profile: Path) -> Iterator[Any]:
    """Run headless Chromium."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    program, server = shutil.which("chromium"), shutil.which("chromedriver")
    if program is None or server is None:
        raise DvrkCmaesError("chromium and chromedriver are not installed; on Debian: apt install chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        f"--user-data-dir={profile}",
    ):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=Service(executable_path=server))
    try:
        yield driver
    finally:
        driver.quit()


def load(browser: Any, path: Path) -> float:
    """Open a page; gives the seconds until it is loaded."""
    browser.get("about:blank")
    browser.get(path.as_uri())
    return 1e-3 * float(browser.execute_script(_LOAD))
