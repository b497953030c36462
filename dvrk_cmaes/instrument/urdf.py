"""A URDF and its mesh files to an `Instrument`.

yourdfpy reads the XML into its robot model; which links and joints belong to the instrument, which joints are
independent, and the meshes in each link's frame are settled here. ``<collision>`` geometry is ignored.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.instrument import measure
from dvrk_cmaes.instrument.cache import keep, kept_file, read_kept
from dvrk_cmaes.instrument.joint_tree import below, build_joints
from dvrk_cmaes.instrument.kinematics import Chain
from dvrk_cmaes.instrument.model import Instrument, Link
from dvrk_cmaes.instrument.urdf_xml import read_robot
from dvrk_cmaes.instrument.visuals import link_triangles
from dvrk_cmaes.io.bundled import bundled_path
from dvrk_cmaes.io.short_text import listed

#: The link whose pose is sought unless another one is named: the distal end of the shaft.
DEFAULT_ROOT = "roll_link"


def bundled_names() -> tuple[str, ...]:
    """Names of the instruments that come with the package."""
    folder = bundled_path("instruments")
    return tuple(sorted(path.parent.name for path in folder.glob("*/*.urdf") if path.stem == path.parent.name))


def _urdf_path(source: str | Path) -> Path:
    if isinstance(source, str) and source in bundled_names():
        return bundled_path("instruments", source, f"{source}.urdf")
    path = Path(source)
    if path.is_file():
        return path
    known = ", ".join(nearest_first(str(source), bundled_names())) or "none"
    if path.is_dir():
        raise InputError(f"{source}: a folder; expected a URDF file or a bundled instrument ({known})")
    raise InputError(f"{source}: no such URDF file, nor a bundled instrument (bundled: {known})")


def load_instrument(
    source: str | Path,
    *,
    package_paths: Mapping[str, str | Path] = MappingProxyType({}),
    root_link: str | None = None,
    shaft_radius: float | None = None,
    shaft_axis: tuple[ArrayLike, ArrayLike] | None = None,
    keep_measured: bool = False,
) -> Instrument:
    """Load a bundled instrument or one described by a URDF.

    Parameters
    ----------
    source
        Name of a bundled instrument (see `bundled_names`) or path of a URDF.
    package_paths
        Folder of each ROS package named in ``package://NAME/...``; a package not listed is looked for upwards
        from the URDF's folder.
    root_link
        Link whose pose is sought, with the shaft on it or below it; ``roll_link`` by default.
    shaft_radius
        In metres, instead of the one measured on the mesh.
    shaft_axis
        Point (3,) in metres and direction (3,), distal, in the root link's frame, instead of the measured axis.
    keep_measured
        Keep what was read and measured on disk, and take it from there the next time (see `kept`).

    Raises
    ------
    InputError
        In one line, what is wrong with which file and field.
    """
    path = _urdf_path(source)
    axis = _checked_axis(shaft_axis)
    packages = sorted((name, str(folder)) for name, folder in package_paths.items())
    told = None if axis is None else [part.tolist() for part in axis]
    place = kept_file(path.absolute(), packages, root_link, shaft_radius, told) if keep_measured else None
    if place is not None and (known := read_kept(place)) is not None:
        return known
    robot = read_robot(path)
    root = root_link if root_link is not None else DEFAULT_ROOT
    names = [link.name for link in robot.links]
    if root not in names:
        raise InputError(
            f"{path}: no link {root!r} to take as the root; links present: {listed(nearest_first(root, names), 12)}"
        )
    tree = below(robot, root, path)
    members = [root, *(joint.child for joint in tree)]
    cache: dict[Path, Any] = {}
    visuals = {link.name: link.visuals for link in robot.links}
    folders = {name: Path(folder) for name, folder in package_paths.items()}
    triangles = {name: link_triangles(visuals[name], name, path, folders, cache) for name in members}
    solid = {name: found for name, found in triangles.items() if found is not None}
    if not solid:
        raise InputError(f"{path}: no visual geometry on link {root!r} or below it; expected at least one mesh")

    joints, joint_names, limits = build_joints(robot, tree, root, set(solid), path)
    chain = Chain(joints)
    joint_above = {root: -1, **{joint.child: index for index, joint in enumerate(joints)}}
    links = tuple(Link(name, *solid[name]) for name in members if name in solid)
    instrument = measure.measured(
        Instrument(
            name=str(robot.name),
            root_link=root,
            links=links,
            joint_names=joint_names,
            limits=limits,
            shaft=None,
            jaw_tips=(),
            chain=chain,
            link_joints=tuple(joint_above[link.name] for link in links),
        ),
        radius=shaft_radius,
        axis=axis,
    )
    if place is not None:
        keep(place, instrument, (path, *cache))
    return instrument


def _checked_axis(
    axis: tuple[ArrayLike, ArrayLike] | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    if axis is None:
        return None
    point, direction = (np.asarray(part, dtype=np.float64) for part in axis)
    if point.shape != (3,) or direction.shape != (3,) or not np.isfinite([point, direction]).all():
        raise InputError("shaft_axis: expected a point (3 finite numbers, m) and a direction (3 finite numbers)")
    length = float(np.linalg.norm(direction))
    if length == 0.0:
        raise InputError("shaft_axis: expected a direction of non-zero length, got (0, 0, 0)")
    direction = direction / length
    return point - (point @ direction) * direction, direction
