"""Shapes of four more dVRK instruments: ProGrasp, Maryland bipolar, mega needle driver, permanent cautery hook; mm.

Every solid is in the frame of its own link. Kinematics and dimensions are those of the dVRK's description of these
tools (dvrk_model, MIT): lengths and outlines as seen along the link's axes. A blade is the common part of two prisms,
one over its outline in the plane in which it opens and one over its outline from the side. Teeth are not modelled, and
cables only where they are seen outside the pulleys. The second jaw is the first one, rotated by half a turn about y.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from manifold3d import Manifold
from solids import arc, box, prism, revolve, rod, tube

Outline = Sequence[tuple[float, float]]
SHAFT_RADIUS: Final = 4.07  # as of the Large Needle Driver, which has the same tube; drawn with 4.365 in dvrk_model
SHAFT_PROXIMAL_END: Final = -323.65  # z
FLANGE_RADIUS: Final = 4.155
WRIST_RADIUS: Final = 4.2  # of the cylinder about the wrist's x axis in which its fork lies


class Tool(NamedTuple):
    """An instrument: its moving links' solids, mm, and what its URDF needs."""

    title: str
    pitch_to_yaw: float
    tip: float  # y of the tool tip frame
    pitch_limit: float
    yaw_limit: float
    jaw_limits: tuple[float, float] | None  # None: no jaws, the link jaw_link is fixed
    jaw_sign: float  # of jaw_1's angle about z for a positive jaw
    slide: tuple[float, float]  # mm and mm/rad, the jaws' own shift along y for an angle of the jaw
    wrist: Manifold
    yaw: Manifold | None
    jaw: Manifold
    other_jaw: Manifold | None = None  # None: jaw rotated by half a turn about y


def between(rows: Sequence[tuple[float, float, float]]) -> Outline:
    """Return the outline between a lower and an upper edge: rows of the place, the lower and the upper edge."""
    return [(low, at) for at, low, _ in rows] + [(high, at) for at, _, high in reversed(rows)]


def roll_link() -> Manifold:
    """Make the roll link: shaft, flange, fork of two lugs, and the pulleys on the pitch axis (y)."""
    shoulder = [(-5, -20), (5, -20), (4.2, -4.6), (3.85, -3.0), (-3.85, -3.0), (-4.2, -4.6)]
    lug = np.concatenate([arc((0.0, -3.0), (2.75, 4.95), 0.0, np.pi), [[-2.75, -4.0], [2.75, -4.0]]])
    fork = prism(lug, -5.0, 5.0, "y") - box((-5.0, -2.9, -3.0), (5.0, 2.9, 5.0))
    solid = (prism(np.array(shoulder), -5.0, 5.0, "y") + fork) ^ rod(FLANGE_RADIUS, -12.0, 5.0)
    for low in (-2.88, 1.12):
        solid += rod(1.88, low, low + 1.76, "y")
    solid += rod(0.7, -3.0, 3.0, "y")
    loop = arc((0.0, 0.0), (2.85, 2.85), 0.0, np.pi)[::8]
    solid += tube([(2.7, 0.0, -3.2), *((x, 0.0, z) for x, z in loop), (-2.7, 0.0, -3.2)], 0.25)
    return solid + rod(SHAFT_RADIUS, SHAFT_PROXIMAL_END, -8.95)


def fork(side: Outline, top: Outline, *, floor: float, inner: tuple[float, float], end: float) -> Manifold:
    """Make a wrist: outlines in the xy and the xz plane, and a fork from its floor to a round end, both in x."""
    body = prism(np.array(side), -5.0, 5.0) ^ prism(np.array(top), -5.0, 5.0, "y")
    radius = 3.02
    round_end = arc((end - radius, 0.0), (radius, radius), -np.pi / 2, np.pi / 2)
    prongs = prism(np.concatenate([[(floor, -radius)], round_end, [(floor, radius)]]), -5.0, 5.0, "y")
    body += prongs - box((floor, inner[0], -5.0), (end + 1, inner[1], 5.0))
    return body ^ rod(WRIST_RADIUS, -10.0, 20.0, "x")


def mirrored(rows: Sequence[tuple[float, float]]) -> Outline:
    """Return the outline between an edge, rows of x and half height, and its mirror image."""
    return [*rows, *((x, -y) for x, y in reversed(rows))]


def wrist_of_jaws() -> Manifold:
    """Make the wrist pitch link of the ProGrasp, the Maryland and the mega needle driver."""
    side = mirrored(
        [(-2.5, 0.4), (-2, 1.62), (-1, 2.48), (0, 2.88), (1, 3.32), (2, 3.85), (3, 4.14), (3.8, 4.5), (6.83, 4.5)]
    )
    top = mirrored([(-2.6, 1.15), (2.4, 1.15), (3.2, 2.0), (3.8, 2.6), (5, 2.75), (6.1, 3.03), (6.83, 3.03)])
    solid = fork(side, top, floor=6.8, inner=(-2.71, 2.71), end=14.42)
    for sign in (1, -1):
        solid += rod(1.6, min(1.5 * sign, 2.75 * sign), max(1.5 * sign, 2.75 * sign), "z", (4.2, -1.8 * sign))
    arch = arc((10.9, 0.0), (3.95, 3.73), np.pi / 2, -np.pi / 2)[::8]
    for y in (-0.65, 0.65):
        path = [(3.0, 0.2 * y, 2.0), *((x, y, z) for x, z in arch), (3.0, 0.2 * y, -2.0)]
        solid += tube(path, 0.2)
    return solid


def wrist_of_hook() -> Manifold:
    """Make the wrist pitch link of the cautery hook."""
    rows = [(-2.4, 0.4), (-2, 1.43), (-1, 2.26), (0, 2.5), (1, 2.85), (2, 3.36), (3, 3.73), (4, 4.0), (4.8, 4.5)]
    side = mirrored([*rows, (5.93, 4.5)])
    top = mirrored([(-2.5, 1.12), (0.5, 1.2), (1, 1.68), (2, 2.0), (3, 2.6), (5, 3.03), (5.93, 3.03)])
    solid = fork(side, top, floor=5.9, inner=(-2.49, 2.75), end=12.94)
    for sign in (1, -1):
        solid += rod(1.5, min(2.1 * sign, 2.93 * sign), max(2.1 * sign, 2.93 * sign), "z", (3.6, 1.45 * sign))
    arch = arc((9.8, 0.0), (2.4, 2.55), np.pi / 2, -np.pi / 2)[::8]
    return solid + tube([(3.0, 0.2, 2.4), *((x, -0.4, z) for x, z in arch), (3.0, 0.2, -2.4)], 0.22)


def prograsp_jaw() -> Manifold:
    """Make a jaw of the ProGrasp: the driven plate behind the hinge, its block, and the fenestrated blade."""
    plate = [(-2.0, -4.2), (-0.9, -6.0), (0.0, -5.8), (0.9, -4.9), (1.1, -3.8), (2.0, -3.2), (2.9, -3.8), (2.9, -5.2),
             (2.0, -6.8), (1.5, -7.2), (2.6, -7.6), (3.55, -6.8), (3.58, -1.65), (2.4, 0.8), (2.1, 2.0), (2.36, 3.6),
             (0.3, 3.6), (-1.41, 3.2), (-1.41, -1.8)]  # fmt: skip
    front = between([
        (3.5, 0.35, 2.36), (6, 0.1, 2.1), (10, 0, 1.68), (14, 0, 1.37), (18, 0, 1.24), (20.3, 0, 1.19),
        (20.95, 0.1, 0.9),
    ])  # fmt: skip
    tip = arc((18.35, 0.0), (2.6, 2.65), np.pi / 2, -np.pi / 2)
    edge = [(3.5, -2.65), (3.5, 0.0), (4.3, 0.0), (5.1, 0.6), (6.2, 2.0), (7.9, 2.63)]
    window = np.concatenate(
        [arc((18.4, 0.0), (1.26, 1.26), -np.pi / 2, np.pi / 2), arc((8.5, 0.0), (1.26, 1.26), np.pi / 2, 1.5 * np.pi)]
    )
    blade = prism(np.array(front), -3.0, 3.0) ^ prism(np.concatenate([edge, tip]), -1.0, 3.0, "x")
    blade -= prism(window, -5.0, 5.0, "x")
    return prism(np.array(plate), -2.65, -1.34) + box((-1.41, -0.37, -2.0), (1.4, 3.3, 0.0)) + blade


def maryland_jaws() -> tuple[Manifold, Manifold]:
    """Make the jaws of the Maryland bipolar forceps: pulley with its head, neck, and the curved, fenestrated blade.

    Both blades are curved to the same side: the second one is the first one's mirror image; its pulley is rotated.
    """
    rim = [(0, 0), (3.43, 0), (3.43, -0.4), (3.1, -0.55), (3.1, -0.75), (3.43, -0.85), (3.43, -1.4), (3.0, -1.65),
           (3.0, -2.1), (3.12, -2.25), (3.12, -2.6), (2.4, -2.94), (0, -2.94)]  # fmt: skip
    head = [(-3.2, 0.9), (-2.05, 4.2), (-1.2, 4.65), (0.4, 4.75), (1.9, 4.5), (2.25, 4.1), (3.25, 0.9)]
    front = between([
        (4.5, -1.75, 1.4), (5, -1.6, 1.33), (6, -1.5, 0.96), (6.6, -1.5, 0.4), (7, -1.5, -0.3), (8, -1.58, -0.3),
        (10, -1.61, -0.22), (12, -1.58, -0.2), (14, -1.49, -0.15), (16, -1.33, -0.03), (18, -1.08, 0.05),
        (20, -0.75, 0.05), (21.04, -0.5, 0),
    ])  # fmt: skip
    necks = (
        [(4.5, -2.4, -1.1), (5, -2.39, -1.04), (6, -2.36, -0.93), (6.6, -2.36, -0.6), (7.2, -2.34, 0.1),
         (8, -2.25, 1.45), (9, -1.95, 2.14)],
        [(4.5, 1.25, 2.37), (6, 1.22, 2.33), (7, 1.13, 2.3), (7.5, 0.71, 2.3), (7.8, -0.6, 2.3), (8, -1.19, 2.3),
         (8.5, -1.57, 2.3), (9, -1.72, 2.31)],
    )  # fmt: skip
    common = [
        (10, -1.54, 2.34), (11, -1.25, 2.36), (12, -1.06, 2.27), (13, -0.91, 2.21), (14, -0.84, 2.06),
        (15, -0.85, 1.84), (16, -0.92, 1.54), (17, -1.06, 1.2), (18, -1.27, 0.79), (19, -1.57, 0.28),
        (20, -1.93, -0.34), (20.7, -2.02, -0.84), (21.04, -1.8, -1.3),
    ]  # fmt: skip
    window = between(
        [(9.2, 0, 0.9), (9.5, -0.4, 1.2), (10, -0.43, 1.39), (12, -0.1, 1.38), (14, 0.05, 1.14), (14.7, 0.4, 0.8)]
    )
    hole = prism(np.array([(y, z) for z, y in window]), -3.0, 3.0, "x")
    blades = []
    for neck in necks:
        side = np.array([(y, z) for z, y in between([*neck, *common])])
        blades.append((prism(np.array(front), -4.0, 4.0) ^ prism(side, -3.0, 3.0, "x")) - hole)
    pulley = revolve(np.array(rim), 3.43) + prism(np.array(head), -2.9, 0.0) + box((-0.9, 3.3, -3.88), (0.9, 4.7, -2.8))
    turned = pulley.transform(np.array([[-1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]))
    return pulley + blades[0], turned + blades[1].mirror((1.0, 0.0, 0.0))


def mega_jaw() -> Manifold:
    """Make a jaw of the mega needle driver: pulley, the block that holds the cable's end, and the blade."""
    rim = [(0, 0), (3.8, 0), (3.62, -0.8), (3.62, -0.95), (3.8, -1.15), (2.95, -2.56), (0, -2.56)]
    front = between([
        (2, 0.1, 3.0), (3, 0.1, 2.7), (4, 0, 2.66), (5, 0.06, 2.59), (6, 0.1, 2.42), (8, 0.1, 2.09), (10, 0.1, 1.76),
        (12, 0.07, 1.42), (12.5, 0.1, 1.21), (12.79, 0.3, 0.9),
    ])  # fmt: skip
    side = between([
        (2, -2.54, 0), (3.2, -2.54, 0), (4, -2.29, 0), (4.5, -1.92, 0), (5, -1.75, 0.11), (5.5, -1.74, 0.65),
        (5.8, -1.74, 1.4), (6.2, -1.74, 1.8), (7, -1.73, 1.79), (9, -1.53, 1.58), (11, -1.31, 1.36), (12, -1.15, 1.2),
        (12.5, -0.77, 0.83), (12.79, -0.3, 0.35),
    ])  # fmt: skip
    blade = prism(np.array(front), -4.0, 4.0) ^ prism(np.array([(y, z) for z, y in side]), -4.0, 4.0, "x")
    return revolve(np.array(rim), 3.8) + blade + box((-1.65, 2.5, -2.2), (0.5, 4.85, -0.4))


def hook() -> Manifold:
    """Make the cautery hook below the yaw axis: body, sleeve, and the bent wire."""
    round_ = arc((0.0, -0.25), (3.37, 3.37), np.pi - 0.3, 2 * np.pi + 0.3)
    body = np.concatenate([round_, [(2.0, 3.55), (1.7, 3.75), (-1.7, 3.75), (-2.0, 3.55)]])
    solid = prism(body, -0.25, 2.29) + prism(0.87 * body, -0.8, -0.2)
    solid += prism(np.array([(x, min(y, 3.2)) for x, y in body]), -1.61, -0.75)
    solid += rod(1.1, -2.52, -1.5) + rod(0.75, 2.2, 2.71)
    along = [(0, 3.5), (1.71, 3.5), (1.71, 6.0), (1.16, 6.4), (1.16, 7.87), (0, 7.87)]
    sleeve = revolve(np.array(along), 1.71).transform(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0.87]]))
    wire = [(0, 7.5), (0, 9.2), (-0.2, 10.1), (-0.85, 10.85), (-1.75, 11.45), (-2.2, 12.1), (-2.27, 12.8),
            (-1.95, 13.7), (-1.2, 14.35), (0, 14.9), (1.1, 15.43)]  # fmt: skip
    return solid + sleeve + tube([(x, y, 0.87) for x, y in wire], 0.64)


def disc() -> Manifold:
    """Make the wrist yaw link of the ProGrasp and the Maryland: a pulley between the jaws, and the pin."""
    return rod(3.8, -1.33, 1.33, "z", (0.0, 0.87)) + rod(0.79, -4.1, 4.1, "z", (0.0, 0.4))


def tools() -> dict[str, Tool]:
    """Make the solids of all four instruments, by name."""
    wrist, yaw, right, still = wrist_of_jaws(), disc(), 1.39626, (0.0, 0.0)
    opening = (-0.349066, right)
    mega_pin, hook_pin = rod(0.9, -4.05, 4.15), rod(0.8, -4.25, 4.25)
    prograsp = ("ProGrasp forceps (400093)", 10.7, 28.6, right, right, (0.0, 1.0472), -1, (7.7, -2.100845))
    maryland = ("Maryland bipolar forceps (400172)", 10.7, 21.0, right, right, opening, 1, still)
    mega = ("mega needle driver (400194)", 11.2, 16.4, 1.2217, right, opening, -1, still)
    cautery = ("permanent cautery hook (400183)", 9.3, 16.0768, right, 1.4835, None, 1, still)
    return {
        "prograsp": Tool(*prograsp, wrist, yaw, prograsp_jaw()),
        "maryland": Tool(*maryland, wrist, yaw, *maryland_jaws()),
        "mega_needle_driver": Tool(*mega, wrist, mega_pin, mega_jaw()),
        "cautery_hook": Tool(*cautery, wrist_of_hook(), hook_pin, hook()),
    }
