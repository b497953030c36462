"""Shape of the Large Needle Driver: its dimensions, and the solid of each link, in millimetres.

Every solid is in the frame of its own link, so that the URDF's visual origins are the identity. The kinematics are the
dVRK's (pitch to yaw axis 9.1 mm); the other dimensions are lengths and radii measured on a Large Needle Driver 400006,
with left and right made equal. The teeth, and the holes for pins and cables, are not modelled.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from manifold3d import Manifold
from solids import arc, bend, box, loft, prism, revolve, rod, rounded_rectangle

# Roll link: +z along the shaft, distally; origin on the pitch axis; pitch axis along y.
SHAFT_RADIUS: Final = 4.07
SHAFT_PROXIMAL_END: Final = -323.65  # z
FLANGE_RADIUS: Final = 4.155  # of the steel end piece, which is thicker than the shaft
FLANGE_PROXIMAL_END: Final = -9.05  # z
FLANGE_DISTAL_END: Final = -3.55  # z, the floor of the fork
LUG_HALF_WIDTH: Final = 2.65  # along x; rounded at the end with the same radius
LUG_ROUNDING_CENTRE: Final = -0.70  # z, so that the lugs end at z = 1.95
LUG_INNER_FACE: Final = 3.23  # |y|
BLOCK_HALF_WIDTH: Final = 1.89  # along x, of the pulleys between the lugs; their radius about the pitch axis too

# Wrist pitch link: +x towards the jaws, z along the pitch axis, yaw axis along y.
PITCH_TO_YAW: Final = 9.1
PITCH_PIN_RADIUS: Final = 0.65
PITCH_PIN_HALF_LENGTH: Final = 4.0
TONGUE_HALF_HEIGHT: Final = 1.0  # along z, about the pitch axis
TONGUE_ROUNDING: Final = (0.84, 3.24)  # x of the centre, radius, in the xy plane
TONGUE_CORNER: Final = -1.57  # x where this rounding meets the sides
FILLET_X: Final = (-0.75, 0.35)  # from the tongue to the body
FILLET_CURVATURE: Final = 0.408  # 1/mm, coefficient of the parabola
BODY_HALF_HEIGHT: Final = 3.0  # along z, of the lens-shaped side view
BODY_WIDEST: Final = 5.05  # x
BODY_PROXIMAL_AXIS: Final = 5.42  # half axis of the lens along x, towards the shaft
BODY_DISTAL_AXIS: Final = 5.55  # towards the jaws: the fork ends at x = 10.6
BODY_HALF_WIDTH: Final = 3.15  # along y
BODY_EDGE_ROUNDING: Final = 0.5
BODY_FLAT_X: Final = (3.0, 6.8)  # where the sides are flat
BODY_PROXIMAL_BEND: Final = 10.7  # radius with which the sides bend inwards towards the shaft
BODY_DISTAL_BEND: Final = 8.4  # the same towards the jaws
FORK_HALF_GAP: Final = 1.95  # along y
FORK_FLOOR: Final = 6.1  # x
PULLEY_IN_FORK: Final = (5.78, 2.42)  # x of the axis, radius

# Jaw links: +y towards the tip, z along the yaw axis. This is jaw_1, at -x and with its pulley at +z; jaw_2 is the same
# jaw rotated by half a turn about y.
# The rim: r, z along the cable's groove.
PULLEY_RIM: Final = ((2.19, 0.03), (2.22, 0.10), (2.22, 0.20), (2.10, 0.55), (2.10, 0.72), (2.26, 0.90), (2.41, 1.0))
PULLEY_RIM_TOP: Final = 1.2  # z
PULLEY_RADIUS: Final = 2.41
PULLEY_TOP: Final = 1.96  # z
PULLEY_TOP_RADIUS: Final = 1.15
BOSS_RIGHT: Final = 1.04  # x, of the block beside the arm that holds the cable's end
BOSS_END: Final = 3.36  # y
BOSS_CURVE: Final = (1.65, 0.70)  # y, z of the centre of the quarter ellipse on its top
BOSS_CORNER: Final = 0.15
BOSS_SET_BACK: Final = 0.03  # its flat faces lie below the arm's and the pulley's, so that no two faces coincide
SLOT: Final = ((-2.0, 2.05, -1.0), (0.5, 2.68, 0.93))  # opposite corners of the cut between pulley and heel
HEEL_OF_PULLEY: Final = ((-1.65, 1.0, 0.06), (0.0, 2.05, 0.7))  # opposite corners of the square foot before the cut
FERRULE: Final = (2.0, 0.61, 0.45)  # y, z of the axis, radius, of the cable's crimp in the slot
FERRULE_X: Final = (-0.74, 0.38)
NECK: Final = (  # y, x left, x right, z low, z high, rounding of the left edges
    (0.00, -1.65, -0.05, 0.04, 1.97, 0.45),
    (2.40, -1.65, -0.05, 0.04, 1.97, 0.45),
    (2.80, -1.65, -0.05, 0.04, 1.92, 0.50),
    (3.00, -1.65, -0.05, 0.04, 1.84, 0.52),
    (3.20, -1.65, -0.05, 0.01, 1.72, 0.55),
    (3.40, -1.63, -0.06, -0.08, 1.54, 0.55),
    (3.50, -1.63, -0.07, -0.17, 1.45, 0.55),
    (3.60, -1.62, -0.09, -0.30, 1.36, 0.55),
    (3.68, -1.61, -0.11, -0.62, 1.30, 0.60),
    (3.80, -1.60, -0.13, -0.84, 1.23, 0.60),
    (3.90, -1.59, -0.15, -0.94, 1.18, 0.60),
    (4.05, -1.57, -0.17, -1.01, 1.12, 0.60),
    (4.20, -1.56, -0.20, -1.03, 1.07, 0.60),
    (4.50, -1.53, -0.24, -1.03, 1.01, 0.62),
    (4.70, -1.49, -0.26, -0.99, 0.97, 0.62),  # inside the blade
)
NECK_RIGHT_ROUNDING: Final = 0.12
BLADE_START: Final = (4.52, -1.53, 1.02, 0.63)  # y, x left, half height along z, rounding of the outer edges
BLADE_ROUNDING_START: Final = (8.90, -1.12, 0.75, 0.60)  # the same where the tip's rounding begins, radius 0.75
BLADE_TIP_THICKNESS: Final = 0.65  # along x, at the very end, y = 9.65
TIP_FRAME: Final = 10.2  # y of the dVRK's tool tip frame, beyond the jaws


def roll_link() -> Manifold:
    """Make the roll link: shaft, end piece with two lugs, and the pulleys between the lugs."""
    lug = np.concatenate([
        arc((0.0, LUG_ROUNDING_CENTRE), (LUG_HALF_WIDTH, LUG_HALF_WIDTH), 0.0, np.pi),
        [[-LUG_HALF_WIDTH, FLANGE_DISTAL_END - 1.0], [LUG_HALF_WIDTH, FLANGE_DISTAL_END - 1.0]],
    ])  # fmt: skip
    block = np.concatenate([
        arc((0.0, 0.0), (BLOCK_HALF_WIDTH, BLOCK_HALF_WIDTH), 0.0, np.pi),
        [[-BLOCK_HALF_WIDTH, FLANGE_DISTAL_END - 1.0], [BLOCK_HALF_WIDTH, FLANGE_DISTAL_END - 1.0]],
    ])  # fmt: skip
    bar = rod(FLANGE_RADIUS, FLANGE_PROXIMAL_END, 10.0)
    room = LUG_INNER_FACE + 0.2
    fork = prism(lug, -10.0, 10.0, "y") - box((-10.0, -LUG_INNER_FACE, -10.0), (10.0, LUG_INNER_FACE, 10.0))
    fork += prism(block, -room, room, "y")
    base = box((-10.0, -10.0, -400.0), (10.0, 10.0, FLANGE_DISTAL_END))
    return (bar ^ (fork + base)) + rod(SHAFT_RADIUS, SHAFT_PROXIMAL_END, FLANGE_PROXIMAL_END + 1.0)


def wrist_pitch_link() -> Manifold:
    """Make the wrist pitch link: tongue about the pitch axis with its pin, lens-shaped body, fork of the jaws."""
    start, stop = FILLET_X
    proximal = np.linspace(np.arccos((stop - BODY_WIDEST) / BODY_PROXIMAL_AXIS), np.pi / 2, 16)
    distal = np.linspace(np.pi / 2, 0.06, 22)[1:]
    x = np.concatenate([[-3.0], np.linspace(start, stop, 7)[:-1]])
    side = np.concatenate([
        np.stack([x, TONGUE_HALF_HEIGHT + FILLET_CURVATURE * np.maximum(x - start, 0) ** 2], 1),
        np.stack([BODY_WIDEST + BODY_PROXIMAL_AXIS * np.cos(proximal), BODY_HALF_HEIGHT * np.sin(proximal)], 1),
        np.stack([BODY_WIDEST + BODY_DISTAL_AXIS * np.cos(distal), BODY_HALF_HEIGHT * np.sin(distal)], 1),
    ])  # fmt: skip
    rings = []
    for x_ring, height in side:
        half = np.array([BODY_HALF_WIDTH, height])
        ring = rounded_rectangle(-half, half, [min(BODY_EDGE_ROUNDING, 0.8 * height)] * 4, [6] * 4)
        rings.append(np.column_stack([np.full(len(ring), x_ring), ring]))
    x_tongue, r_tongue = TONGUE_ROUNDING
    distal_end = BODY_WIDEST + BODY_DISTAL_AXIS
    turn = np.arccos((TONGUE_CORNER - x_tongue) / r_tongue)
    upper = np.concatenate([
        bend(BODY_FLAT_X[1], distal_end + 0.1, BODY_DISTAL_BEND, BODY_HALF_WIDTH)[::-1],
        bend(BODY_FLAT_X[0], TONGUE_CORNER + 0.4, BODY_PROXIMAL_BEND, BODY_HALF_WIDTH),
        arc((x_tongue, 0.0), (r_tongue, r_tongue), turn, np.pi),
    ])  # fmt: skip
    top = np.concatenate([upper, upper[-2::-1] * [1, -1]])
    body = loft(np.array(rings)) ^ prism(top, -4.0, 4.0)
    body -= box((FORK_FLOOR, -FORK_HALF_GAP, -4.0), (12.0, FORK_HALF_GAP, 4.0))
    x_pulley, r_pulley = PULLEY_IN_FORK
    room = FORK_HALF_GAP + 0.2
    body += rod(r_pulley, -room, room, "y", (x_pulley, 0.0)) ^ box((FORK_FLOOR - 0.5, -room, -4.0), (12.0, room, 4.0))
    return body + rod(PITCH_PIN_RADIUS, -PITCH_PIN_HALF_LENGTH, PITCH_PIN_HALF_LENGTH)


def pulley() -> Manifold:
    """Make the cable pulley about the yaw axis, which is domed on its outer side."""
    rise = PULLEY_TOP - PULLEY_RIM_TOP
    z_centre = (PULLEY_TOP + PULLEY_RIM_TOP) / 2 - (PULLEY_RADIUS**2 - PULLEY_TOP_RADIUS**2) / (2 * rise)
    z = np.linspace(PULLEY_RIM_TOP, PULLEY_TOP, 7)
    radius = np.sqrt(PULLEY_RADIUS**2 + (PULLEY_RIM_TOP - z_centre) ** 2 - (z - z_centre) ** 2)
    outline = np.concatenate([[(0.0, PULLEY_RIM[0][1])], PULLEY_RIM, np.stack([radius, z], 1), [(0.0, PULLEY_TOP)]])
    return revolve(outline, PULLEY_RADIUS)


def blade() -> Manifold:
    """Make the gripping part of jaw_1: flat on the side of the other jaw, rounded outside and at the tip."""
    start, turn = np.array(BLADE_START), np.array(BLADE_ROUNDING_START)
    radius = turn[2]  # the tip is a half circle as high as the blade
    rows = [start, turn]
    for angle in np.deg2rad([12, 24, 35, 45, 54, 62, 69, 75, 80, 84]):
        shrink = float(np.cos(angle))
        thickness = BLADE_TIP_THICKNESS + (-turn[1] - BLADE_TIP_THICKNESS) * shrink
        rows.append(np.array([turn[0] + radius * np.sin(angle), -thickness, radius * shrink, 0.8 * radius * shrink]))
    rings = []
    for y, left, half, rounding in rows:
        r = min(rounding, 0.8 * half)
        ring = rounded_rectangle(np.array([left, -half]), np.array([0.0, half]), [0, 0, r, r], [0, 0, 8, 8])
        rings.append(np.column_stack([ring[:, 0], np.full(len(ring), y), ring[:, 1]]))
    return loft(np.array(rings))


def jaw_1_link() -> Manifold:
    """Make the link of jaw_1: pulley, arm, the block that holds the cable's end, and the blade."""
    rings = []
    for y, left, right, low, high, r in NECK:
        radii = [NECK_RIGHT_ROUNDING, NECK_RIGHT_ROUNDING, r, r]
        ring = rounded_rectangle(np.array([left, low]), np.array([right, high]), radii, [2, 2, 8, 8])
        rings.append(np.column_stack([ring[:, 0], np.full(len(ring), y), ring[:, 1]]))
    y_curve, z_curve = BOSS_CURVE
    foot, top = PULLEY_RIM[0][1] + BOSS_SET_BACK, PULLEY_TOP - BOSS_SET_BACK
    corner = (BOSS_END - BOSS_CORNER, foot + BOSS_CORNER)
    boss = np.concatenate([
        [(0.0, foot)],
        arc(corner, (BOSS_CORNER, BOSS_CORNER), -np.pi / 2, 0.0),
        arc((y_curve, z_curve), (BOSS_END - y_curve, top - z_curve), 0.0, np.pi / 2),
        [(0.0, top)],
    ])  # fmt: skip
    arm = loft(np.array(rings)) + prism(boss, -0.8, BOSS_RIGHT, "x") - box(*SLOT) + box(*HEEL_OF_PULLEY)
    y_ferrule, z_ferrule, r_ferrule = FERRULE
    return pulley() + arm + rod(r_ferrule, *FERRULE_X, "x", (y_ferrule, z_ferrule)) + blade()
