"""Fixtures that several packages' tests use, and deselection of tests whose requirements are not met."""

from __future__ import annotations

import gc
import json
import os
import shutil
import signal
import tempfile
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.done_once import done_once
from helpers.files import read_mask
from helpers.named_failures import NamedFailures
from helpers.places import SHARED
from helpers.plain_pictures import plain_pictures, small_overlays
from helpers.processes_here import processes_here, real_processes
from helpers.shared_estimates import estimated_anew, shared_estimates, short_searches
from hypothesis import settings

from dvrk_cmaes import Body, Camera, load_instrument, read_camera

settings.register_profile("steady", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("many", settings.get_profile("steady"), max_examples=100)
settings.load_profile("many" if os.environ.get("CI") == "true" else "steady")


@dataclass(frozen=True)
class Requirement:
    """Files or programs outside the project, without which the tests with a mark cannot run."""

    mark: str
    missing: str
    """What the tests need and why it is missing; follows "N tests need" in the summary."""
    is_met: Callable[[], bool]


REQUIREMENTS = (
    Requirement("shared", "../shared (real meshes and frames), which is not beside this checkout", SHARED.is_dir),
    Requirement(
        "browser",
        "chromium and chromedriver (Debian: apt-get install chromium chromium-driver), which are not installed",
        lambda: None not in map(shutil.which, ("chromium", "chromedriver")),
    ),
)
LONGEST = (
    *("test_recordings", "test_reference_examples", "test_frames", "test_fuzz", "test_background"),
    *("test_calibrations", "test_keyframe_tracker", "test_tutorial", "test_calibrate", "test_steered_session"),
    *("test_import_surgpose", "test_page", "test_outputs", "test_notebook", "test_session_rig", "test_live"),
    *("test_by_model", "test_tracker", "test_formats", "test_classic", "test_segment", "test_model"),
    *("test_session_tools", "test_estimate_golden", "test_rig_tracking", "test_cluster", "test_image_tracking"),
    *("test_renderer", "test_pool", "test_held", "test_bombs", "test_estimate", "test_user_reports"),
    *("test_examples", "test_sam2", "test_readme_examples"),
)
"""Files of tests that take longest, in the order in which they begin; all others follow.

Towards the end, no worker is left alone with one that takes long. Worlds of ``promises`` that several files need are
made by the first of them, for which others would wait at that time.
"""
_IN_MEMORY, _PLENTY = "/dev/shm", 8e9  # bytes; a run of all tests keeps less than one of these 8 GB
DESELECTED = pytest.StashKey[dict[str, int]]()
"""Number of selected tests without what they require, by mark."""


def in_ci() -> bool:
    return os.environ.get("CI") == "true"


def pytest_configure(config: pytest.Config) -> None:
    config.stash[DESELECTED] = {}
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # OpenCV reads it at the first use of FFmpeg, in any test
    if not hasattr(config, "workerinput"):  # the process with the terminal
        config.pluginmanager.register(NamedFailures(config))
        _keep_files_in_memory()
    gc.disable()  # until the tests are collected: what is made meanwhile stays
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # in the background of a shell; commands would inherit it
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _keep_files_in_memory() -> None:
    """Let temporary files be in memory, where there is plenty: removing some 40,000 from a disk takes its time."""
    if "TMPDIR" not in os.environ and os.path.isdir(_IN_MEMORY) and shutil.disk_usage(_IN_MEMORY).free > _PLENTY:
        os.environ["TMPDIR"] = _IN_MEMORY
        tempfile.tempdir = None  # is found anew


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Take one process more than there are cores: some tests wait for servers, and for processes that they end."""
    return (os.cpu_count() or 1) + 1


def order(item: pytest.Item) -> tuple[int, str]:
    """Give the place of a test's file in LONGEST, and the file."""
    return LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST), str(item.path)


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Let every second process collect the files from the last one on, so that it finds half of them compiled."""
    report = yield
    if isinstance(collector, pytest.Dir) and int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]) % 2:
        report.result.reverse()
    return report


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Mark the tests with the fixture ``shared``, and put the files that take longest first.

    After -m and -k, deselect tests whose requirements are not met.
    With ``CI=true`` and any such test, all tests are removed and the run fails.
    """
    for item in items:
        if "shared" in getattr(item, "fixturenames", ()):
            item.add_marker("shared")
    items.sort(key=order)
    yield
    deselected = config.stash[DESELECTED]
    for requirement in REQUIREMENTS:
        unmet = [item for item in items if item.get_closest_marker(requirement.mark)]
        if not unmet or requirement.is_met():
            continue
        deselected[requirement.mark] = len(unmet)
        items[:] = [item for item in items if not item.get_closest_marker(requirement.mark)]
        config.hook.pytest_deselected(items=unmet)
    if deselected and in_ci():
        items.clear()
    if hasattr(config, "workeroutput"):  # a worker of pytest-xdist
        config.workeroutput["deselected"] = deselected


def pytest_collection_finish() -> None:
    """Let garbage collections pass over the modules and the collected tests, which stay until the end."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)  # less often than usually
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Copy the counts of a worker of pytest-xdist to the controller; all workers collect the same tests."""
    node.config.stash[DESELECTED].update(getattr(node, "workeroutput", {}).get("deselected", {}))


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.stash[DESELECTED] and in_ci():
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    for requirement in REQUIREMENTS:
        if count := config.stash[DESELECTED].get(requirement.mark):
            effect = "no test was run, because CI=true" if in_ci() else "deselected"
            terminalreporter.write_line(f"{count} tests need {requirement.missing}: {effect}", red=in_ci(), yellow=True)


@pytest.fixture(autouse=True, scope="session")
def _instrument_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Set an instrument cache for the tests, separate from the user's; the workers of pytest-xdist share it."""
    own = tmp_path_factory.getbasetemp()
    folder = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DVRK_CMAES_CACHE", str(folder / "cache"))
        yield


@pytest.fixture(autouse=True, scope="session")
def _done_once() -> Iterator[None]:
    """Let the program do once for all tests of a process what depends on a command's or an instrument's content."""
    with done_once():
        yield


@pytest.fixture
def tasks_here() -> Iterator[None]:
    """Let a test run the tasks of worker processes in its own process, which is quicker by a second for each worker."""
    with processes_here():
        yield


@pytest.fixture
def own_processes(tasks_here: None) -> Iterator[None]:
    """Let a test have real worker processes where the others of its file do without."""
    with real_processes():
        yield


@pytest.fixture
def estimates_shared() -> Iterator[None]:
    """Let commands and batches of a test, and of others with this fixture, estimate each frame once for all of them."""
    with shared_estimates():
        yield


@pytest.fixture
def estimates_anew(estimates_shared: None) -> Iterator[None]:
    """Let each estimate of a test be made where the others of its file share them."""
    with estimated_anew():
        yield


@pytest.fixture(scope="module")
def searches_short() -> Iterator[None]:
    """Let the searches of a file's tests be of a third of the usual candidates, where their settings are not given."""
    with short_searches():
        yield


@pytest.fixture
def search_short() -> Iterator[None]:
    """Let the searches of a test be as short where those of its file's other tests are as usual."""
    with short_searches():
        yield


@pytest.fixture
def small_pictures() -> Iterator[None]:
    """Let commands of a test draw frames in their own size, and pages without pictures."""
    with plain_pictures(), small_overlays():
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real meshes, frames and files beside the checkout."""
    return SHARED


@pytest.fixture(scope="session")
def bundled_body() -> Body:
    """The bundled Large Needle Driver, prepared for rendering."""
    return Body.prepare(load_instrument("lnd"))


@pytest.fixture(scope="session")
def scanned_body(shared: Path) -> Body:
    """The scanned Large Needle Driver; its shaft is open and not manifold."""
    return Body.prepare(load_instrument(shared / "instruments" / "lnd_400006" / "lnd_400006.urdf"))


@dataclass(frozen=True, eq=False)
class GoldenFrames:
    """Frames with known truth: poses (N, 4, 4), joints (N, 3) in the instrument's order, masks (N, H, W)."""

    camera: Camera
    camera_from_root: np.ndarray
    joints: np.ndarray
    masks: np.ndarray


@pytest.fixture(scope="session")
def clean_frames(shared: Path) -> GoldenFrames:
    """Frames of the scanned needle driver whose masks are exact to a hundredth of a pixel."""
    folder = shared / "frames" / "made" / "clean"
    frames = json.loads((folder / "golden.json").read_text())["frames"]
    names = sorted(frames)
    joint_names = ("wrist_pitch", "wrist_yaw", "jaw")
    return GoldenFrames(
        camera=read_camera(folder / "camera.yaml"),
        camera_from_root=np.array([frames[name]["T_camera_roll_link"] for name in names]),
        joints=np.array([[frames[name]["joints"][joint] for joint in joint_names] for name in names]),
        masks=np.stack([read_mask(folder / "masks" / f"{name}.png") for name in names]),
    )
