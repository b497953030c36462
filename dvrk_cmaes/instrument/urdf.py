"""Loading of an `Instrument` from a URDF and its mesh files.

yourdfpy parses the XML. This module selects the links and joints of the instrument, determines the independent joints,
reads the meshes and transforms them into their links' frames. ``<collision>`` geometry is ignored.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.instrument import measure
from dvrk_cmaes.instrument.joint_tree import build_joints, joints_below
from dvrk_cmaes.instrument.kinematics import Chain
from dvrk_cmaes.instrument.locate import cache_file, find_mesh, read_cached, write_cached
from dvrk_cmaes.instrument.model import Instrument, Link
from dvrk_cmaes.instrument.urdf_xml import read_robot
from dvrk_cmaes.instrument.visuals import link_triangles
from dvrk_cmaes.io.arguments import PATH, check_type
from dvrk_cmaes.io.files import bundled_path
from dvrk_cmaes.io.short_text import listed, no_folder

#: Default name of the link whose pose is estimated: the one at the distal end of the shaft.
DEFAULT_ROOT = "roll_link"

#: Bundled instruments by the end of the dVRK's number, in which 400 or 420 before it is the generation, S or Si.
_NUMBERS = {"006": "lnd", "093": "prograsp", "172": "maryland", "183": "cautery_hook", "194": "mega_needle_driver"}


def bundled_names() -> tuple[str, ...]:
    """Return the names of the instruments bundled with the package, sorted."""
    return tuple(sorted(_bundled()))


def _bundled() -> dict[str, Path]:
    return {path.stem: path for path in bundled_path("instruments").glob("*/*.urdf")}


def _urdf_path(source: str | Path, folders: Iterable[str | Path]) -> Path:
    """Return the path of a bundled or given URDF, or of that of a number in folders; InputError if there is none."""
    name, searched = str(source).lower(), [*map(str, folders)]
    if name[:3] in ("400", "420") and not searched:
        name = _NUMBERS.get(name[3:], name)
    if name in (bundled := _bundled()):
        return bundled[name]
    path = Path(source)
    if path.is_file():
        return path
    if name.isdecimal() and searched:
        for folder in (folder for folder in searched if not Path(folder).is_dir()):
            raise InputError(f"{folder}: {no_folder(folder)}; expected a folder with URDFs, of which {source} is one")
        found = [urdf for folder in searched for urdf in sorted(Path(folder).rglob("*.urdf"))]
        fitting = [urdf for urdf in found if name in urdf.stem]
        if len(fitting) == 1:
            return fitting[0]
        there = listed(
            [urdf.name for urdf in fitting] or nearest_first(name, [urdf.stem for urdf in found]) or ["none"]
        )
        raise InputError(
            f"{source}: expected one URDF of this number in {listed(searched)}, got {len(fitting)}: {there}"
        )
    known = ", ".join(nearest_first(str(source), bundled_names())) or "none"
    if path.is_dir():
        raise InputError(f"{source}: a folder; expected a URDF file or a bundled instrument ({known})")
    number = "; others by number: `--description DIR`, or by the path of a URDF" if name.isdecimal() else ""
    raise InputError(f"{source}: no such URDF file, nor a bundled instrument (bundled: {known}{number})")


def load_instrument(
    source: str | Path,
    *,
    package_paths: Mapping[str, str | Path] = MappingProxyType({}),
    root_link: str | None = None,
    use_cache: bool = False,
) -> Instrument:
    """Load a bundled instrument or one described by a URDF.

    Parameters
    ----------
    source
        Name or number of a bundled instrument (see `bundled_names`), path of a URDF, or the number of one in
        ``package_paths``.
    package_paths
        Folder of each ROS package named in ``package://NAME/...``; other packages are searched for in the URDF's folder
        and its parents.
    root_link
        Link whose pose is estimated, with the shaft on it or below it; ``roll_link`` by default.
    use_cache
        Read the instrument from the disk cache if it is there, otherwise write it (see `dvrk_cmaes.instrument.locate`),
        and do so with what is prepared of its meshes.

    Raises
    ------
    InputError
        A file cannot be read or used; the one-line message names the file, the field and the error.
    """
    check_type("instrument", source, PATH, "a bundled instrument's name or the path of a URDF")
    path = _urdf_path(source, package_paths.values())
    packages = sorted((name, str(folder)) for name, folder in package_paths.items())
    cached = cache_file(path.absolute(), packages, root_link) if use_cache else None
    folders = {name: Path(folder) for name, folder in package_paths.items()}
    if cached is not None and (instrument := read_cached(cached, path, folders)) is not None:
        return instrument
    robot = read_robot(path)
    root = root_link if root_link is not None else DEFAULT_ROOT
    names = [link.name for link in robot.links]
    if root not in names:
        raise InputError(
            f"{path}: no link {root!r} to take as the root; links present: {listed(nearest_first(root, names), 12)}"
        )
    tree = joints_below(robot, root, path)
    members = [root, *(joint.child for joint in tree)]
    meshes: dict[Path, Any] = {}
    visuals = {link.name: link.visuals for link in robot.links}
    triangles = {name: link_triangles(visuals[name], name, path, folders, meshes) for name in members}
    geometry = {name: mesh for name, mesh in triangles.items() if mesh is not None}
    if not geometry:
        raise InputError(f"{path}: no visual geometry on link {root!r} or below it; expected at least one mesh")

    joints, joint_names, limits = build_joints(robot, tree, root, set(geometry), path)
    parent_joint = {root: -1, **{joint.child: index for index, joint in enumerate(joints)}}
    links = tuple(Link(name, *geometry[name]) for name in members if name in geometry)
    of_links = tuple(parent_joint[link.name] for link in links)
    instrument = Instrument(str(robot.name), root, links, joint_names, limits, None, (), Chain(joints), of_links)
    instrument = measure.with_measurements(instrument)
    if cached is not None:
        shapes = [visual.geometry.mesh for name in members for visual in visuals[name] if visual.geometry.mesh]
        places = {mesh.filename: find_mesh(mesh.filename, path, folders, str(path)) for mesh in shapes}
        write_cached(cached, instrument, path, places)
    return instrument
