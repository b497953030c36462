"""Check of the sizes stated in a mesh file's header against the file's size, before the file is parsed.

Parsers allocate memory for the number of faces stated in the header, and may take a truncated file for one of another
format. A binary STL has a header of 80 bytes, the number of faces, and 50 bytes for each face; a text STL begins with
"solid". A PLY header has a line "element NAME COUNT" for each element.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

from dvrk_cmaes.errors import InputError

_LFS_POINTER = b"version https://git-lfs"
_HEADER = 100_000  # bytes; longer than a PLY header
_STL_HEADER, _STL_FACE = 84, 50  # bytes
_PLY_ELEMENT = re.compile(rb"^element\s+(\S+)\s+(\d+)\s*$", re.MULTILINE)


def check_header_sizes(path: Path, data: bytes) -> None:
    """Check that a mesh file, whose content is ``data``, is as large as its header states.

    Raises
    ------
    InputError
        The file is a Git LFS pointer, or smaller than its header states.
    """
    size, head = len(data), data[:_HEADER]
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
            if len(count) > len(str(size)) or int(count) > size:  # an entry has at least one byte
                stated = count[:20].decode()
                raise InputError(
                    f"{path}: element {name[:20].decode(errors='replace')}: {stated} are claimed, in {size} bytes"
                )
