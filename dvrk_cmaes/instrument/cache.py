"""Instruments kept on disk, once their meshes were read and measured, which takes longer than to find a pose.

One file each in the user's cache folder (``$XDG_CACHE_HOME``, or ``~/.cache``, below ``dvrk-cmaes``), which anybody may
delete: arrays and plain values, never code. It is used as long as URDF and meshes are byte for byte those it was made
from, by this version. ``DVRK_CMAES_CACHE`` names another folder, or is ``off``.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import zipfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes._version import __version__
from dvrk_cmaes.errors import DvrkCmaesError
from dvrk_cmaes.instrument.kinematics import Chain, Joint
from dvrk_cmaes.instrument.model import Instrument, JawTip, Link, Shaft
from dvrk_cmaes.io.atomic import write_bytes
from dvrk_cmaes.io.files import file_digest

_LARGEST = 500_000_000  # bytes
_FORMAT = 1


def kept_file(*asked: object) -> Path | None:
    """Where an instrument that was asked for in these words is kept; None where nothing is to be."""
    folder = os.environ.get("DVRK_CMAES_CACHE", "")
    if folder == "off":
        return None
    try:
        root = Path(folder) if folder else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # no home
        return None
    key = hashlib.sha256(repr((_FORMAT, __version__, *asked)).encode()).hexdigest()[:24]
    return (root if folder else root / "dvrk-cmaes") / f"{key}.npz"


def read_kept(path: Path) -> Instrument | None:
    """Read a kept instrument; None where there is none, or it was made from other files, or is damaged."""
    try:
        if path.stat().st_size > _LARGEST:
            return None
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as arrays:
            told = json.loads(str(arrays["told"]))
            if any(file_digest(Path(name)) != digest for name, digest in told["files"].items()):
                return None
            return _instrument(told, arrays)
    except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError, zipfile.BadZipFile):
        return None


def keep(path: Path, instrument: Instrument, files: Iterable[Path]) -> None:
    """Keep an instrument that was made from files; does nothing where that cannot be written."""
    told: dict[str, Any] = {
        "files": {str(file.absolute()): file_digest(file) for file in files},
        "name": instrument.name,
        "root_link": instrument.root_link,
        "links": [link.name for link in instrument.links],
        "joint_names": instrument.joint_names,
        "tips": [tip.link for tip in instrument.jaw_tips],
        "link_joints": instrument.link_joints,
        "has_twin": instrument.has_twin,
        "chain": [_plain(joint) for joint in instrument.chain.joints],
    }
    arrays: dict[str, Any] = {"limits": instrument.limits}
    for i, link in enumerate(instrument.links):
        arrays |= {f"vertices_{i}": link.vertices, f"faces_{i}": link.faces}
    for i, joint in enumerate(instrument.chain.joints):
        arrays |= {f"place_{i}": joint.parent_from_joint, f"axis_{i}": joint.axis}
    for i, tip in enumerate(instrument.jaw_tips):
        arrays[f"tip_{i}"] = tip.position
    shaft = instrument.shaft
    if shaft is not None:
        arrays |= {"shaft_point": shaft.point, "shaft_direction": shaft.direction}
        told["shaft"] = [shaft.radius, shaft.distal_end, shaft.proximal_end]
    data = io.BytesIO()
    np.savez(data, told=np.array(json.dumps(told)), **arrays)
    with contextlib.suppress(DvrkCmaesError, OSError):
        write_bytes(path, data.getvalue())


def _plain(joint: Joint) -> dict[str, Any]:
    """Fields of a joint but for its arrays."""
    return {name: value for name, value in asdict(joint).items() if not isinstance(value, np.ndarray)}


def _instrument(told: dict[str, Any], arrays: Any) -> Instrument:
    joints = tuple(
        Joint(parent_from_joint=arrays[f"place_{i}"], axis=arrays[f"axis_{i}"], **fields)
        for i, fields in enumerate(told["chain"])
    )
    shaft = None
    if "shaft" in told:
        shaft = Shaft(arrays["shaft_point"], arrays["shaft_direction"], *told["shaft"])
    return Instrument(
        name=told["name"],
        root_link=told["root_link"],
        links=tuple(Link(name, arrays[f"vertices_{i}"], arrays[f"faces_{i}"]) for i, name in enumerate(told["links"])),
        joint_names=tuple(told["joint_names"]),
        limits=arrays["limits"],
        shaft=shaft,
        jaw_tips=tuple(JawTip(link, arrays[f"tip_{i}"]) for i, link in enumerate(told["tips"])),
        chain=Chain(joints),
        link_joints=tuple(told["link_joints"]),
        has_twin=told["has_twin"],
    )
