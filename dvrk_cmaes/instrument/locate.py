"""Resolution of mesh file names in a URDF: relative and absolute paths, ``file://`` and ``package://``."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import unquote

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import read_text

_PACKAGE = "package://"
_LARGEST_MANIFEST = 1_000_000  # bytes
_MOST_TRIED = 6  # paths listed in a message


def find_mesh(filename: str, urdf: Path, packages: Mapping[str, Path], where: str) -> Path:
    """Return the path of an existing mesh file.

    ``package://NAME/rest`` is resolved in ``packages[NAME]`` if that is given. Otherwise the URDF's folder and its
    parents are searched for a folder called NAME, a folder containing a folder NAME, and a folder whose package.xml
    declares the package NAME. Such a path must not leave its package.

    Parameters
    ----------
    filename
        The file name as written in the URDF.
    urdf
        Path of the URDF; relative names are relative to its folder.
    packages
        Folder of each known package, by package name.
    where
        Prefix of error messages.

    Raises
    ------
    InputError
        No such file (the message lists the paths tried), a path that leaves its package, or an unknown scheme.
    """
    folder = urdf.resolve().parent
    if filename.startswith(_PACKAGE):
        candidates = list(_in_package(filename, folder, packages, where))
    elif filename.startswith("file:"):
        inside = filename.removeprefix("file:").removeprefix("//").removeprefix("localhost/")
        candidates = [folder / unquote(f"/{inside}" if "//localhost/" in filename else inside)]
    elif "://" in filename:
        raise InputError(f"{where}: mesh {filename}: expected a path, file:// or package://")
    else:
        candidates = [folder / filename]
    tried = list(dict.fromkeys(candidates))
    for path in tried:
        if path.is_file():
            return path
    more = f" and {len(tried) - _MOST_TRIED} more" if len(tried) > _MOST_TRIED else ""
    hint = " (say where the package lies with --package-path NAME=DIR)" if filename.startswith(_PACKAGE) else ""
    raise InputError(
        f"{where}: mesh {filename}: no such file; tried {', '.join(map(str, tried[:_MOST_TRIED]))}{more}{hint}"
    )


def _in_package(filename: str, folder: Path, packages: Mapping[str, Path], where: str) -> Iterator[Path]:
    """Yield the candidate paths of a ``package://`` name; ``folder`` is the URDF's."""
    name, _, inside = filename.removeprefix(_PACKAGE).partition("/")
    if not name or name in (".", "..") or "\\" in filename:
        raise InputError(f"{where}: mesh {filename}: expected package://NAME/path/of/the/mesh")
    depth = 0
    for part in inside.split("/"):
        depth += {"..": -1, ".": 0, "": 0}.get(part, 1)
        if depth < 0:
            raise InputError(f"{where}: mesh {filename}: refused, the path climbs out of its package")
    inside = inside.lstrip("/")
    if name in packages:
        yield packages[name] / inside
        return
    for parent in (folder, *folder.parents):
        if parent.name == name:
            yield parent / inside
        if (parent / name).is_dir():
            yield parent / name / inside
        if parent.name != name and _package_name(parent / "package.xml") == name:
            yield parent / inside


def _package_name(manifest: Path) -> str | None:
    """Read the name of a ROS package from its manifest; None if the file or the name is missing."""
    try:
        text = read_text(manifest, expected="the manifest of a ROS package", largest=_LARGEST_MANIFEST)
    except InputError:
        return None
    match = re.search(r"<name>\s*([^<\s]+)\s*</name>", text)
    return match.group(1) if match else None
