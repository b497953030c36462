"""What the rest of the package knows of an instrument: meshes, joints, shaft, jaw tips, mirror twin.

Nothing here reads a file; :func:`dvrk_cmaes.instrument.load_instrument` builds an `Instrument` from a URDF.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.instrument.arm import ROLL_OFFSET
from dvrk_cmaes.instrument.kinematics import Chain

#: Joints that change sign in the mirror twin.
TWIN_JOINTS = ("wrist_pitch", "wrist_yaw")

_SKELETON_STEP = 0.01  # m between the skeleton's points along the shaft


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body: its name and its surface in its own frame.

    Parameters
    ----------
    name
        The URDF's.
    vertices : (V, 3) float64
        In metres; those of one mesh file welded, so that neighbouring faces share them.
    faces : (F, 3) int32
        Counter-clockwise seen from outside where the mesh file has them so; none degenerate.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Shaft:
    """The straight cylindrical part of the insertion shaft, in the root link's frame.

    Parameters
    ----------
    point : (3,)
        The point of the axis nearest to the root link's origin, m.
    direction : (3,)
        Unit vector along the axis, distal (towards the wrist).
    radius
        Half the width of the silhouette, m, averaged over all directions of view: for a mesh with flat sides
        between the radii of the circles in and around it.
    distal_end, proximal_end
        Coordinates along `direction` from `point`, m, where the straight part ends; flange and wrist lie beyond.
    """

    point: NDArray[np.float64]
    direction: NDArray[np.float64]
    radius: float
    distal_end: float
    proximal_end: float

    @property
    def length(self) -> float:
        """Length of the straight part, m."""
        return self.distal_end - self.proximal_end


class JawTip(NamedTuple):
    """Far end of one jaw: index into `Instrument.links` and (3,) position in that link's frame, m."""

    link: int
    position: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Instrument:
    """An articulated instrument from its root link down.

    Parameters
    ----------
    name
        The URDF's name of the robot.
    root_link
        Link whose pose is sought; the poses of all others follow from the joints.
    links
        Those with geometry, the root first if it has any; L of them.
    joint_names
        Independent joints that move geometry, in the order of the chain; J of them.
    limits : (J, 2)
        Lower and upper, rad or m; -pi and pi for a continuous joint.
    shaft
        The cylinder seen as two straight edges, None if there is none.
    jaw_tips
        Two, or none for an instrument without a pair of jaws.
    chain
        The joints between the links.
    link_joints
        Of each link, the index in the chain of the joint above it; -1 for the root link.
    has_twin
        Whether the mirror twin of a pose looks the same but for small details (see `twin`).
    limits_from
        Where the limits are from: the URDF, or the name of a tool's description.
    roll_offset
        D of the tool's roll joint, m: where the root lies along the shaft (see `dvrk_cmaes.instrument.arm`).
    roll_limits
        Lower and upper of the roll joint, rad, where they are known.
    """

    name: str
    root_link: str
    links: tuple[Link, ...]
    joint_names: tuple[str, ...]
    limits: NDArray[np.float64]
    shaft: Shaft | None
    jaw_tips: tuple[JawTip, ...]
    chain: Chain
    link_joints: tuple[int, ...]
    has_twin: bool = False
    limits_from: str = "URDF"
    roll_offset: float = ROLL_OFFSET
    roll_limits: tuple[float, float] | None = None

    def _values(self, joints: ArrayLike) -> NDArray[np.float64]:
        values = np.asarray(joints, dtype=np.float64)
        if values.ndim == 0 or values.shape[-1] != len(self.joint_names):
            raise InputError(
                f"{self.name}: joints: expected {len(self.joint_names)} values ({', '.join(self.joint_names)}) "
                f"in the last axis, got an array of shape {values.shape}"
            )
        return values

    def forward(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (..., J) joint values to (..., L, 4, 4) root_from_link, in the order of `links`.

        Joint values beyond the limits are taken as they are. Raises `InputError` for a wrong number of joints.
        """
        return self.chain.forward(self._values(joints), self.link_joints)

    def tips(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Jaw tips in the root link's frame: (..., J) joint values to (..., 2, 3) m; (..., 0, 3) without jaws."""
        values = self._values(joints)
        if not self.jaw_tips:
            return np.empty((*values.shape[:-1], 0, 3))
        poses = self.chain.forward(values, [self.link_joints[tip.link] for tip in self.jaw_tips])
        positions = np.stack([tip.position for tip in self.jaw_tips])
        return np.asarray((poses[..., :3, :3] @ positions[:, :, None])[..., 0] + poses[..., :3, 3])

    def joint_index(self, name: str) -> int:
        """Column of a joint in `joint_names`. Raises `InputError` with the known names, the likeliest first."""
        if name not in self.joint_names:
            known = ", ".join(nearest_first(name, self.joint_names)) or "none"
            raise InputError(f"{self.name}: unknown joint {name!r}; expected one of: {known}")
        return self.joint_names.index(name)

    def skeleton(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Points that sketch the instrument in one configuration, for drawing.

        Along the shaft from its proximal to its distal end, at most a centimetre apart, then the origins of
        the joints from the wrist to the jaws (pitch axis, yaw axis), then the jaw tips. All but the tips form
        one polyline; each tip joins its last point.

        Parameters
        ----------
        joints : (J,)
            Joint values.

        Returns
        -------
        points : (K, 3)
            In metres, in the root link's frame; the last ``len(jaw_tips)`` are the tips.
        """
        values = self._values(joints)
        points = [np.empty((0, 3))]
        if self.shaft is not None:
            count = max(2, int(np.ceil(self.shaft.length / _SKELETON_STEP)) + 1)
            along = np.linspace(self.shaft.proximal_end, self.shaft.distal_end, count)
            points.append(self.shaft.point + along[:, None] * self.shaft.direction)
        hinges = self._hinges()
        if hinges:
            points.append(self.chain.forward(values, hinges)[..., :3, 3])
        points.append(self.tips(values))
        return np.concatenate(points)

    def _hinges(self) -> list[int]:
        """List the moving joints on the way to the jaws, without those that stay where the one before is."""
        last = self.jaw_tips[0].link if self.jaw_tips else len(self.links) - 1
        hinges: list[int] = []
        for index in self.chain.path(self.link_joints[last]):
            joint = self.chain.joints[index]
            stays = joint.motion != "prismatic" and not np.any(joint.parent_from_joint[:3, 3])
            if (joint.moves and not hinges) or (hinges and not stays):
                hinges.append(index)
        return hinges

    @property
    def reach(self) -> float:
        """Largest distance, m, of the links below the root from the root link's origin, all joints at zero."""
        poses = self.forward(np.zeros(len(self.joint_names)))
        below = [k for k, joint in enumerate(self.link_joints) if joint >= 0] or range(len(self.links))
        return max(
            float(np.linalg.norm(self.links[k].vertices @ poses[k, :3, :3].T + poses[k, :3, 3], axis=1).max())
            for k in below
        )

    def half_turn(self) -> NDArray[np.float64]:
        """Half a turn about the roll axis, (4, 4) in the root link's frame.

        The roll axis is the root's z axis where the shaft runs along it (the dVRK's convention), otherwise the
        measured axis of the shaft.
        """
        direction, point = np.array([0.0, 0.0, 1.0]), np.zeros(3)
        if self.shaft is not None and (
            abs(self.shaft.direction[2]) < np.cos(np.deg2rad(1.0)) or np.linalg.norm(self.shaft.point) > 0.5e-3
        ):
            direction, point = self.shaft.direction, self.shaft.point
        turn = np.eye(4)
        turn[:3, :3] = 2.0 * np.outer(direction, direction) - np.eye(3)
        turn[:3, 3] = point - turn[:3, :3] @ point
        return turn

    def twin(self, camera_from_root: ArrayLike, joints: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Give the mirror twin: roll half a turn further, wrist pitch and yaw negated, all else the same.

        Its silhouette is nearly that of the pose itself where `has_twin` is true. The twin of the twin is the
        pose itself.

        Parameters
        ----------
        camera_from_root : (..., 4, 4)
            Pose of the root link.
        joints : (..., J)
            Joint values.

        Returns
        -------
        camera_from_root, joints
            Those of the twin, in the same shapes.
        """
        values = self._values(joints).copy()
        for name in TWIN_JOINTS:
            if name in self.joint_names:
                values[..., self.joint_index(name)] *= -1.0
        return np.asarray(camera_from_root, dtype=np.float64) @ self.half_turn(), values
