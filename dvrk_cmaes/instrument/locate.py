"""Where the meshes of a URDF are, and the disk cache of the instruments that were loaded from them.

Names of mesh files are relative and absolute paths, ``file://`` and ``package://``. Reading and measuring meshes takes
longer than estimating a pose: each instrument is one file of arrays and JSON values (.npz) in the folder of
`io.files.cache_folder`. A
cached file is used only if the same version of the package wrote it and the URDF and mesh files still have the digests
recorded in it, and would be found where they were.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from zipfile import BadZipFile

import msgspec
import numpy as np

from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.instrument.model import Instrument
from dvrk_cmaes.io.files import cache_folder, file_digest, read_text
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.io.typed_document import prepared

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


_FORMAT = 6
_DOCUMENT = "document"  # name of the JSON values among the arrays
_UNUSABLE = (OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, BadZipFile, InputError)
"""Errors of a file that is missing, damaged, or has not the arrays and values that are expected."""


def cache_file(*arguments: object) -> Path | None:
    """Return the path of the cache file for what follows from arguments; None if the cache is off or has no folder."""
    folder = cache_folder()
    if folder is None:
        return None
    key = hashlib.sha256(repr((_FORMAT, __version__, *arguments)).encode()).hexdigest()[:24]
    return folder / f"{key}.npz"


def read_cached(path: Path, urdf: Path, packages: Mapping[str, Path]) -> Instrument | None:
    """Read a cached instrument; None if the file is missing or damaged, or a search finds other source files now."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files if name != _DOCUMENT}
            document = json.loads(str(found[_DOCUMENT]))
        if any(file_digest(Path(name)) != digest for name, digest in document["files"].items()):
            return None
        if any(
            str(find_mesh(name, urdf, packages, "").absolute()) != found for name, found in document["meshes"].items()
        ):
            return None
        return msgspec.convert(document["instrument"], prepared(Instrument), dec_hook=lambda _, name: arrays[name])
    except _UNUSABLE:
        return None


def write_cached(path: Path, instrument: Instrument, urdf: Path, meshes: Mapping[str, Path]) -> None:
    """Write an instrument and the digests of its source files to the cache; failure to write is ignored.

    ``meshes`` are the paths of the meshes by the names that the URDF gives them.
    """
    arrays: dict[str, Any] = {}

    def named(value: Any) -> Any:
        """Return the name of an array, which is kept by it, and the value of a number of NumPy."""
        if not isinstance(value, np.ndarray):
            return value.item()
        arrays[name := f"array {len(arrays)}"] = value
        return name

    document = {
        "files": {str(file.absolute()): file_digest(file) for file in (urdf, *meshes.values())},
        "meshes": {name: str(found.absolute()) for name, found in meshes.items()},
        "instrument": msgspec.to_builtins(instrument, enc_hook=named),
    }
    with contextlib.suppress(DvrkCmaesError, OSError):
        file, arrays[_DOCUMENT] = io.BytesIO(), json.dumps(document)
        np.savez(file, **arrays)
        write_bytes(path, file.getvalue())
