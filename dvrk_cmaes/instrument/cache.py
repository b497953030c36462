"""Disk cache of loaded instruments; reading and measuring their meshes takes longer than estimating a pose.

Each instrument is one file of arrays and JSON values (`io.array_file`) in the folder of `io.bundled.cache_folder`. A
cached file is used only if the same version of the package wrote it and the URDF and mesh files still have the digests
recorded in it, and would be found where they were.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.instrument.kinematics import Chain, Joint
from dvrk_cmaes.instrument.locate import find_mesh
from dvrk_cmaes.instrument.model import Instrument, JawTip, Link, Shaft
from dvrk_cmaes.io.array_file import UNUSABLE, read_arrays, write_arrays
from dvrk_cmaes.io.bundled import cache_folder
from dvrk_cmaes.io.files import file_digest

_FORMAT = 4


def cache_file(*arguments: object) -> Path | None:
    """Return the path of the cache file for what follows from arguments; None if the cache is off or has no folder."""
    folder = cache_folder()
    if folder is None:
        return None
    key = hashlib.sha256(repr((_FORMAT, __version__, *arguments)).encode()).hexdigest()[:24]
    return folder / f"{key}.arrays"


def read_cached(path: Path, urdf: Path, packages: Mapping[str, Path]) -> Instrument | None:
    """Read a cached instrument; None if the file is missing or damaged, or a search finds other source files now."""
    try:
        document, arrays = read_arrays(path)
        if any(file_digest(Path(name)) != digest for name, digest in document["files"].items()):
            return None
        if any(
            str(find_mesh(name, urdf, packages, "").absolute()) != found for name, found in document["meshes"].items()
        ):
            return None
        return _instrument(document, arrays)
    except (*UNUSABLE, InputError):
        return None


def write_cached(path: Path, instrument: Instrument, urdf: Path, meshes: Mapping[str, Path]) -> None:
    """Write an instrument and the digests of its source files to the cache; failure to write is ignored.

    ``meshes`` are the paths of the meshes by the names that the URDF gives them.
    """
    document: dict[str, Any] = {
        "files": {str(file.absolute()): file_digest(file) for file in (urdf, *meshes.values())},
        "meshes": {name: str(found.absolute()) for name, found in meshes.items()},
        "name": instrument.name,
        "root_link": instrument.root_link,
        "links": [link.name for link in instrument.links],
        "joint_names": instrument.joint_names,
        "tips": [tip.link for tip in instrument.jaw_tips],
        "link_joints": instrument.link_joints,
        "has_twin": instrument.has_twin,
        "chain": [_plain_fields(joint) for joint in instrument.chain.joints],
    }
    arrays: dict[str, Any] = {"limits": instrument.limits}
    for i, link in enumerate(instrument.links):
        arrays |= {f"vertices_{i}": link.vertices, f"faces_{i}": link.faces}
    for i, joint in enumerate(instrument.chain.joints):
        arrays |= {f"parent_from_joint_{i}": joint.parent_from_joint, f"axis_{i}": joint.axis}
    for i, tip in enumerate(instrument.jaw_tips):
        arrays[f"tip_{i}"] = tip.position
    shaft = instrument.shaft
    if shaft is not None:
        arrays |= {"shaft_point": shaft.point, "shaft_direction": shaft.direction}
        document["shaft"] = [shaft.radius, shaft.distal_end, shaft.proximal_end]
    with contextlib.suppress(DvrkCmaesError, OSError):
        write_arrays(path, document, arrays)


def _plain_fields(joint: Joint) -> dict[str, Any]:
    """Return the fields of a joint that are not arrays."""
    return {name: value for name, value in asdict(joint).items() if not isinstance(value, np.ndarray)}


def _instrument(document: dict[str, Any], arrays: Any) -> Instrument:
    """Build an instrument from the JSON document and the arrays of a cache file."""
    joints = tuple(
        Joint(parent_from_joint=arrays[f"parent_from_joint_{i}"], axis=arrays[f"axis_{i}"], **fields)
        for i, fields in enumerate(document["chain"])
    )
    shaft = None
    if "shaft" in document:
        shaft = Shaft(arrays["shaft_point"], arrays["shaft_direction"], *document["shaft"])
    named = enumerate(document["links"])
    links = tuple(Link(name, arrays[f"vertices_{i}"], arrays[f"faces_{i}"]) for i, name in named)
    tips = tuple(JawTip(link, arrays[f"tip_{i}"]) for i, link in enumerate(document["tips"]))
    lists, moved = (tuple(document["joint_names"]), arrays["limits"]), tuple(document["link_joints"])
    whole = document["name"], document["root_link"], links, *lists, shaft, tips, Chain(joints), moved
    return Instrument(*whole, has_twin=document["has_twin"])
