"""Small URDFs and meshes for the tests of the instrument loader, and the paths of the real ones."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from dvrk_cmaes import Instrument, load_instrument
from helpers.places import SHARED

INSTRUMENTS = SHARED / "instruments"
SCANNED = INSTRUMENTS / "lnd_400006" / "lnd_400006.urdf"
HOOK = INSTRUMENTS / "dvrk_model" / "urdf" / "instrument_400183.urdf"
ALL_SHARED = [
    SCANNED,
    *(INSTRUMENTS / "dvrk_model/urdf" / f"instrument_400{n}.urdf" for n in ("006", "093", "172", "183", "194")),
]


@cache
def loaded(source: str | Path) -> Instrument:
    """Load an instrument without options, once for all tests of a run, whose processes share the cache."""
    return load_instrument(source, use_cache=True)


TETRA_OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def write_urdf(folder: Path, body: str, name: str = "robot.urdf") -> Path:
    """Write a URDF whose <robot> holds the body."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(f'<?xml version="1.0"?><robot name="test">{body}</robot>', encoding="utf-8")
    return path


def mesh_link(filename: str, attributes: str = "", origin: str = "") -> str:
    """Give the XML of a roll_link with one mesh."""
    return (
        f'<link name="roll_link"><visual>{origin}<geometry><mesh filename="{filename}" {attributes}/></geometry>'
        "</visual></link>"
    )


def box_link(name: str, size: str = "0.01 0.01 0.01", xyz: str = "0 0 0") -> str:
    """Give the XML of a link that is a box."""
    return f'<link name="{name}"><visual><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></visual></link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str = "") -> str:
    """Give the XML of a joint, with limits of -1 and 1 unless the inside states others."""
    limit = "" if "<limit" in inside else '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}{limit}</joint>'


def gripper(shaft: str = '<cylinder radius="0.004" length="0.3"/>', shaft_at: str = "0 0 -0.16") -> str:
    """Give the XML of a shaft along z with a flange, a wrist of two hinges, and a pair of jaws 20 mm long."""
    jaws = "".join(
        joint(
            f"jaw_{k}",
            "revolute",
            "wrist_yaw_link",
            f"jaw_{k}_link",
            f'<axis xyz="0 0 1"/><mimic joint="jaw" multiplier="{m}"/>',
        )
        + box_link(f"jaw_{k}_link", "0.002 0.02 0.003", f"{x} 0.01 0")
        for k, m, x in ((1, 0.5, -0.001), (2, -0.5, 0.001))
    )
    return (
        f'<link name="roll_link"><visual><origin xyz="{shaft_at}"/><geometry>{shaft}</geometry></visual>'
        '<visual><origin xyz="0 0 -0.005"/><geometry><cylinder radius="0.006" length="0.01"/></geometry></visual>'
        "</link>"
        + joint(
            "wrist_pitch",
            "revolute",
            "roll_link",
            "wrist_pitch_link",
            '<origin rpy="-1.5707963267948966 -1.5707963267948966 0"/><axis xyz="0 0 1"/>',
        )
        + box_link("wrist_pitch_link", "0.009 0.004 0.004", "0.0045 0 0")
        + joint(
            "wrist_yaw",
            "revolute",
            "wrist_pitch_link",
            "wrist_yaw_link",
            '<origin xyz="0.009 0 0" rpy="-1.5707963267948966 -1.5707963267948966 0"/><axis xyz="0 0 1"/>',
        )
        + '<link name="wrist_yaw_link"/>'
        + joint(
            "jaw",
            "revolute",
            "wrist_yaw_link",
            "jaw_link",
            '<axis xyz="0 0 1"/><limit lower="-0.2" upper="1.4" effort="1" velocity="1"/>',
        )
        + '<link name="jaw_link"><visual><geometry><box size="0 0 0"/></geometry></visual></link>'
        + jaws
    )
