"""Small inputs that claim, or expand to, huge sizes; and a child process that reads them.

Run as a program, it reads ``{"first": [[name, [argument, ...]], ...], "bombs": [...]}`` as JSON from stdin, runs each
command line in this process, and prints for each bomb its name, exit code, output, duration (s) and the growth of the
process's largest memory use (MB).
"""

from __future__ import annotations

import contextlib
import io
import json
import resource
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

ROOM = 1_500_000_000  # bytes of address space beyond those in use once all libraries are loaded


def png(width: int, height: int, more: bytes = b"") -> bytes:
    """Give a grey PNG that states a size, with few bytes of pixels and optional further chunks."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + more + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


def laughs_yaml(levels: int = 12) -> str:
    """Give YAML in which every level refers to the level before nine times."""
    lines = ["a0: &a0 [ha, ha, ha, ha, ha, ha, ha, ha, ha]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, levels)]
    return "\n".join(lines)


def laughs_xml(root: str, levels: int = 12) -> str:
    """Give XML in which every entity refers to the entity before ten times."""
    entities = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, levels))
    return f'<?xml version="1.0"?><!DOCTYPE {root} [<!ENTITY a0 "ha">{entities}]><{root}>&a{levels - 1};</{root}>'


def outside_xml(root: str) -> str:
    """Give XML with an external entity."""
    return f'<?xml version="1.0"?><!DOCTYPE {root} [<!ENTITY x SYSTEM "file:///etc/passwd">]><{root}>&x;</{root}>'


def deep_xml(root: str, levels: int = 200_000) -> str:
    return f"<{root}>{'<a>' * levels}{'</a>' * levels}</{root}>"


def many_links(count: int = 100_000) -> str:
    joints = "".join(
        f'<joint name="j{k}" type="fixed"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(count - 1)
    )
    return '<robot name="x">' + "".join(f'<link name="l{k}"/>' for k in range(count)) + joints + "</robot>"


def stl(faces: int, there: int) -> bytes:
    """Give a binary STL that states ``faces`` faces and has ``there``."""
    return bytes(80) + struct.pack("<I", faces) + bytes(50 * there)


def ply(kind: str, vertices: int, faces: int) -> bytes:
    """Give a PLY that states more elements than the few bytes that follow."""
    head = f"ply\nformat {kind} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    return head.encode() + (b"0 0 0\n" * 9 if kind == "ascii" else bytes(200))


def dae(count: str, numbers: str = "0 0 0") -> str:
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset><unit meter="1"/></asset>'
        f'<library_geometries><geometry id="g"><mesh><source id="s"><float_array id="f" count="{count}">{numbers}'
        f'</float_array><technique_common><accessor source="#f" count="{count}" stride="3">'
        '<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>'
        '</technique_common></source><vertices id="v"><input semantic="POSITION" source="#s"/></vertices>'
        f'<triangles count="{count}"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>'
        "</mesh></geometry></library_geometries></COLLADA>"
    )


def npy(shape: str) -> bytes:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + bytes(48)


def bag(size: int) -> bytes:
    """Give a ROS 1 bag whose first record states a size."""
    return b"#ROSBAG V2.0\n" + struct.pack("<I", size) + b"\x04\x00\x00\x00op=\x03" + bytes(500)


def mcap(size: int) -> bytes:
    """Give an MCAP file whose first record states a size."""
    return b"\x89MCAP0\r\n\x01" + struct.pack("<Q", size) + bytes(500) + b"\x89MCAP0\r\n"


def text(make: Callable[[], str]) -> Callable[[], bytes]:
    return lambda: make().encode()


NESTED = 100_000
CLIMBING = (
    '<robot name="x"><link name="roll_link"><visual><geometry><mesh filename="package://robots/a/../../../x.stl"/>'
    "</geometry></visual></link></robot>"
)

#: By kind of input: pairs of a file's name and a function that makes its content.
BOMBS: dict[str, list[tuple[str, Callable[[], bytes]]]] = {
    "mask": [
        ("huge.png", lambda: png(100_000, 100_000)),
        ("wide.png", lambda: png(2_000_000_000, 1)),
        ("remark.png", lambda: png(640, 480, _remark())),
    ],
    "image": [("huge.png", lambda: png(100_000, 100_000)), ("huge.jpg", lambda: _jpeg(60_000))],
    "ignore": [("huge.png", lambda: png(100_000, 100_000))],
    "camera": [
        ("laughs.yaml", text(laughs_yaml)),
        ("lists.yaml", text(lambda: "K: " + "[" * NESTED)),
        ("maps.yaml", text(lambda: "".join(f"{' ' * k}a:\n" for k in range(1300)))),
        ("items.yaml", text(lambda: "K: [" + "1," * 400_000 + "1]")),
        ("number.yaml", text(lambda: "width: " + "9" * 900_000)),
        ("merged.yaml", text(lambda: "a: &a {b: 1}\n" + "".join(f"c{k}: {{<<: *a}}\n" for k in range(9)))),
        ("code.yaml", text(lambda: "!!python/object/apply:os.system ['touch bang']")),
        ("laughs.xml", text(lambda: laughs_xml("opencv_storage"))),
        ("outside.xml", text(lambda: outside_xml("opencv_storage"))),
        ("deep.xml", text(lambda: deep_xml("opencv_storage", 100_000))),
        ("sixteen.xml", lambda: laughs_xml("opencv_storage").encode("utf-16")),
    ],
    "joints": [
        ("columns.csv", text(lambda: "frame," + ",".join(f"a{k}" for k in range(60_000)) + "\n")),
        ("cell.csv", text(lambda: 'frame,jaw\n0000,"' + "9" * 5_000_000)),
        ("laughs.yaml", text(lambda: laughs_yaml() + "\nposition: *a11\n")),
        ("lists.yaml", text(lambda: "position: " + "[" * NESTED)),
        ("shape.npy", lambda: npy("(1000000000000,)")),
    ],
    "settings": [
        ("nested.toml", text(lambda: "a = " + "[" * NESTED)),
        ("dotted.toml", text(lambda: ".".join("a" * 20_000) + " = 1")),
    ],
    "instrument": [
        ("laughs.urdf", text(lambda: laughs_xml("robot"))),
        ("outside.urdf", text(lambda: outside_xml("robot"))),
        ("deep.urdf", text(lambda: deep_xml("robot"))),
        ("links.urdf", text(many_links)),
        ("climbs.urdf", text(lambda: CLIMBING)),
        ("words.urdf", text(lambda: f'<robot name="{"x" * 15_000_000}"/>')),
    ],
    "mesh": [
        ("claims.stl", lambda: stl(0xFFFFFFFF, 1)),
        ("few.stl", lambda: stl(80_000_000, 2)),
        ("laughs.dae", text(lambda: laughs_xml("COLLADA"))),
        ("outside.dae", text(lambda: outside_xml("COLLADA"))),
        ("deep.dae", text(lambda: deep_xml("COLLADA"))),
        ("claims.dae", text(lambda: dae("99999999999"))),
        ("vertices.ply", lambda: ply("binary_little_endian", 4_000_000_000, 1)),
        ("faces.ply", lambda: ply("binary_little_endian", 3, 4_000_000_000)),
        ("lines.ply", lambda: ply("ascii", 4_000_000_000, 1)),
        ("line_faces.ply", lambda: ply("ascii", 3, 4_000_000_000)),
        ("index.obj", text(lambda: "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n")),
        ("negative.obj", text(lambda: "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -9999999999 2 3\n")),
    ],
    "result": [
        ("nested.json", text(lambda: "[" * 1_000_000)),
        ("objects.json", text(lambda: '{"a":' * NESTED)),
        ("number.json", text(lambda: '{"seconds": ' + "9" * 1_000_000 + "}")),
    ],
    "recording": [
        ("record.bag", lambda: bag(0xFFFFFFF0)),
        ("record.mcap", lambda: mcap(2**62)),
        ("record_40.mcap", lambda: mcap(2**40)),
        ("laughs/metadata.yaml", text(lambda: laughs_yaml() + "\nrosbag2_bagfile_information: *a11\n")),
        ("lists/metadata.yaml", text(lambda: "rosbag2_bagfile_information: " + "[" * NESTED)),
    ],
}


def _remark() -> bytes:
    """Give a PNG chunk of compressed text that expands to 200 MB."""
    shrink = zlib.compressobj(9)
    data = b"Comment\0\0" + b"".join(shrink.compress(bytes(10_000_000)) for _ in range(20)) + shrink.flush()
    return struct.pack(">I", len(data)) + b"zTXt" + data + struct.pack(">I", zlib.crc32(b"zTXt" + data))


def _jpeg(size: int) -> bytes:
    """Give a JPEG that states a width and a height of ``size``."""
    import cv2
    import numpy as np

    data = bytearray(cv2.imencode(".jpg", np.zeros((16, 16), np.uint8))[1].tobytes())
    start = data.index(b"\xff\xc0")
    data[start + 5 : start + 9] = struct.pack(">HH", size, size)
    return bytes(data)


def _run_all() -> None:
    """Run the commands on stdin with limited address space and CPU time."""
    from dvrk_cmaes.cli import main

    jobs = json.load(sys.stdin)
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        for _, arguments in jobs["first"]:  # so that all libraries are loaded
            main(arguments)
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + ROOM, taken + ROOM))
    resource.setrlimit(resource.RLIMIT_CPU, (200, 200))
    for name, arguments in jobs["bombs"]:
        said = io.StringIO()
        before = resource.getrusage(resource.RUSAGE_SELF)
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            code = main(arguments)
        after = resource.getrusage(resource.RUSAGE_SELF)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        grown = (after.ru_maxrss - before.ru_maxrss) / 1e3
        print(json.dumps([name, code, said.getvalue(), seconds, grown]), flush=True)


if __name__ == "__main__":
    _run_all()
