"""Disk cache of loaded instruments; reading and measuring their meshes takes longer than estimating a pose.

Each instrument is one file of arrays and JSON values (.npz) in the folder of `io.bundled.cache_folder`. A
cached file is used only if the same version of the package wrote it and the URDF and mesh files still have the digests
recorded in it, and would be found where they were.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import msgspec
import numpy as np

from dvrk_cmaes.config import __version__
from dvrk_cmaes.errors import DvrkCmaesError, InputError
from dvrk_cmaes.instrument.locate import find_mesh
from dvrk_cmaes.instrument.model import Instrument
from dvrk_cmaes.io.bundled import cache_folder
from dvrk_cmaes.io.files import file_digest
from dvrk_cmaes.io.output import write_bytes
from dvrk_cmaes.io.typed_document import prepared

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
