"""Fixtures that several test files use."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import settings

from dvrk_cmaes.camera import Camera
from dvrk_cmaes.camera.files import read_camera
from dvrk_cmaes.frames.images import read_mask
from dvrk_cmaes.instrument import load_instrument
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.silhouette import Body

if TYPE_CHECKING:
    from accuracy_cases import Case

settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")


@pytest.fixture(autouse=True, scope="session")
def _kept_instruments(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep measured instruments for these tests alone, not among the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DVRK_CMAES_CACHE", str(tmp_path_factory.mktemp("kept")))
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of real meshes, frames and files beside the checkout; tests that use it carry the mark ``shared``."""
    folder = Path(__file__).resolve().parents[2] / "shared"
    if not folder.is_dir():
        message = f"needs the folder {folder}, which is kept beside the checkout"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    return folder


@pytest.fixture(scope="session")
def bundled_body() -> Body:
    """The bundled Large Needle Driver, prepared for rendering."""
    return Body.prepare(load_instrument("lnd"))


@pytest.fixture(scope="session")
def scanned_body(shared: Path) -> Body:
    """The scanned Large Needle Driver; its shaft is open and not manifold."""
    return Body.prepare(load_instrument(shared / "instruments" / "lnd_400006" / "lnd_400006.urdf"))


@pytest.fixture
def scripts_on_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let tests import the scripts' modules."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / "scripts"))


@pytest.fixture
def cases(scripts_on_path: None) -> list[Case]:
    """The bundled session's frames as scripts/accuracy.py reads them."""
    from accuracy_cases import read_cases

    return read_cases([str(bundled_path("demo"))], instrument="lnd", frames=None)


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
