"""What a mesh file says of itself, held against its size before a parser believes it.

A parser takes memory for as many faces as a header claims, or takes a file that was cut off for one of another kind.
STL: 80 bytes, the number of faces, 50 bytes each; text instead begins with "solid". PLY: "element NAME COUNT" lines.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.files import check_file

_LARGEST = 500_000_000  # bytes; scanned instruments have some ten million
_LFS_POINTER = b"version https://git-lfs"
_HEADER = 100_000  # bytes, more than any PLY's header has
_STL_HEADER, _STL_FACE = 84, 50  # bytes
_PLY_ELEMENT = re.compile(rb"^element\s+(\S+)\s+(\d+)\s*$", re.MULTILINE)


def check_claims(path: Path) -> None:
    """Refuse a mesh file that cannot be what its name and header say.

    Raises
    ------
    InputError
        Not a regular file, over 500 MB, a Git LFS pointer, or shorter than what it claims to hold.
    """
    check_file(path, expected="a mesh file", largest=_LARGEST)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(_HEADER)
    except OSError as error:
        raise InputError(f"{path}: cannot read the mesh: {error.strerror}") from None
    if head.startswith(_LFS_POINTER):
        raise InputError(f"{path}: a Git LFS pointer, not the mesh itself; fetch it with 'git lfs pull'")
    suffix = path.suffix.lower()
    if suffix == ".stl" and len(head) >= _STL_HEADER and not head.lstrip().lower().startswith(b"solid"):
        (faces,) = struct.unpack_from("<I", head, _STL_HEADER - 4)
        whole = _STL_HEADER + _STL_FACE * faces
        if size < whole:
            raise InputError(f"{path}: cut off or no STL: expected {whole} bytes of {faces} faces, got {size}")
    if suffix == ".ply":
        for name, count in _PLY_ELEMENT.findall(head.partition(b"end_header")[0]):
            if len(count) > len(str(_LARGEST)) or int(count) > size:  # each takes a byte at least
                claimed = count[:20].decode()
                raise InputError(
                    f"{path}: element {name[:20].decode(errors='replace')}: {claimed} are claimed, in {size} bytes"
                )
