"""Model of an articulated instrument: meshes, joints, shaft, jaw tips, mirror twin.

:func:`dvrk_cmaes.instrument.load_instrument` builds an `Instrument` from a URDF; this module reads no files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.geometry import Float64
from dvrk_cmaes.instrument.arm import ROLL_OFFSET, Arm
from dvrk_cmaes.instrument.kinematics import Chain

#: Joints that change sign in the mirror twin.
TWIN_JOINTS = ("wrist_pitch", "wrist_yaw")

_SKELETON_STEP = 0.01  # m; largest distance between the skeleton's points along the shaft


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body: its name and its surface in its own frame.

    Parameters
    ----------
    name
        Name in the URDF.
    vertices : (V, 3) float64
        In metres; vertices from one mesh file are welded, so that neighbouring faces share them.
    faces : (F, 3) int32
        Vertex indices, with the winding of the mesh file (counter-clockwise seen from outside, by convention); none is
        degenerate.
    """

    name: str
    vertices: Float64
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
        Half the width of the silhouette, m, averaged over all viewing directions; for a prism it lies between the
        radii of the inscribed and the circumscribed circle.
    distal_end, proximal_end
        Coordinates of the ends of the straight part along `direction` from `point`, m; flange and wrist lie beyond.
    """

    point: Float64
    direction: Float64
    radius: float
    distal_end: float
    proximal_end: float

    @property
    def length(self) -> float:
        """Length of the straight part, m."""
        return self.distal_end - self.proximal_end


class JawTip(NamedTuple):
    """Tip of one jaw: index into `Instrument.links` and position (3,) in that link's frame, m."""

    link: int
    position: Float64


@dataclass(frozen=True, eq=False)
class Instrument:
    """An articulated instrument: the root link and all links below it.

    Parameters
    ----------
    name
        Name of the robot in the URDF.
    root_link
        Link whose pose is estimated; the poses of all others follow from the joint values.
    links
        The L links with geometry, the root link first if it has any.
    joint_names
        The J independent joints that move geometry, in the order of the chain.
    limits : (J, 2)
        Lower and upper limits of the independent joints, rad or m; -pi and pi for a continuous joint.
    shaft
        The cylinder whose silhouette is two straight edges; None if there is none.
    jaw_tips
        Tips of the two jaws; empty for an instrument without a pair of jaws.
    chain
        The joints between the links.
    link_joints
        For each link, the index in the chain of its parent joint; -1 for the root link.
    has_twin
        Whether the mirror twin of a pose has nearly the same silhouette (see `twin`).
    limits_from
        Source of the limits: ``URDF``, or the name of a tool's description file.
    roll_offset
        DH parameter d of the tool's roll joint, m (see `dvrk_cmaes.instrument.arm`).
    roll_limits
        Lower and upper limit of the roll joint, rad; None if not known.
    """

    name: str
    root_link: str
    links: tuple[Link, ...]
    joint_names: tuple[str, ...]
    limits: Float64
    shaft: Shaft | None
    jaw_tips: tuple[JawTip, ...]
    chain: Chain
    link_joints: tuple[int, ...]
    has_twin: bool = False
    limits_from: str = "URDF"
    roll_offset: float = ROLL_OFFSET
    roll_limits: tuple[float, float] | None = None

    def __repr__(self) -> str:
        """Show name, links and joints."""
        links = ", ".join(link.name for link in self.links)
        return f"Instrument({self.name!r}, links: {links}, joints: {', '.join(self.joint_names)})"

    def _values(self, joints: ArrayLike) -> Float64:
        """Check joint values (..., J) and convert them to an array."""
        values = np.asarray(joints, dtype=np.float64)
        if values.ndim == 0 or values.shape[-1] != len(self.joint_names):
            raise InputError(
                f"{self.name}: joints: expected {len(self.joint_names)} values ({', '.join(self.joint_names)}) "
                f"in the last axis, got an array of shape {values.shape}"
            )
        return values

    def forward(self, joints: ArrayLike) -> Float64:
        """Compute root_from_link (..., L, 4, 4) in the order of `links` from joint values (..., J).

        Joint values beyond the limits are not clipped.

        Parameters
        ----------
        joints
            Joint values, rad, in the order of `joint_names`, on the last axis.

        Raises
        ------
        InputError
            The last axis does not have J values.
        """
        return self.chain.forward(self._values(joints), self.link_joints)

    def forward_with_derivatives(self, joints: ArrayLike) -> tuple[Float64, Float64]:
        """Compute root_from_link as `forward`, and its derivatives by the joints, (..., J, L, 4, 4).

        Parameters
        ----------
        joints
            Joint values, rad, in the order of `joint_names`, on the last axis.

        Raises
        ------
        InputError
            The last axis does not have J values.
        """
        return self.chain.forward_with_derivatives(self._values(joints), self.link_joints)

    def tips(self, joints: ArrayLike) -> Float64:
        """Compute the jaw tips in the root link's frame, m, from joint values (..., J).

        The result has the shape (..., 2, 3), or (..., 0, 3) for an instrument without a pair of jaws.

        Parameters
        ----------
        joints
            Joint values (..., J), rad, in the order of `joint_names`.
        """
        values = self._values(joints)
        return self._points(self.jaw_tips, values) if self.jaw_tips else np.empty((*values.shape[:-1], 0, 3))

    def ends(self, joints: ArrayLike) -> Float64:
        """Compute the jaw tips (..., 2, 3) as `tips`, or for an instrument without a pair of jaws its end (..., 1, 3).

        The end is the vertex of the last link that is farthest from the root's origin with all joints at zero.

        Parameters
        ----------
        joints
            Joint values (..., J), rad, in the order of `joint_names`.
        """
        if self.jaw_tips:
            return self.tips(joints)
        pose, vertices = self.forward(np.zeros(len(self.joint_names)))[-1], self.links[-1].vertices
        farthest = np.linalg.norm(vertices @ pose[:3, :3].T + pose[:3, 3], axis=1).argmax()
        return self._points([JawTip(len(self.links) - 1, vertices[farthest])], self._values(joints))

    def _points(self, points: Sequence[JawTip], values: Float64) -> Float64:
        """Compute points of links in the root link's frame, (..., K, 3) m, from joint values (..., J)."""
        poses = self.chain.forward(values, [self.link_joints[point.link] for point in points])
        positions = np.stack([point.position for point in points])
        return np.asarray((poses[..., :3, :3] @ positions[:, :, None])[..., 0] + poses[..., :3, 3])

    def joint_index(self, name: str) -> int:
        """Return the index of a joint in `joint_names`; InputError for an unknown name, with the known ones.

        Parameters
        ----------
        name
            Name of the joint.
        """
        if name not in self.joint_names:
            known = ", ".join(nearest_first(name, self.joint_names)) or "none"
            raise InputError(f"{self.name}: unknown joint {name!r}; expected one of: {known}")
        return self.joint_names.index(name)

    @property
    def stated(self) -> dict[str, Any]:
        """What results state of the instrument: ``instrument``, its name, ``root_link`` and ``shaft_radius``, m."""
        return {"instrument": self.name, "root_link": self.root_link, "shaft_radius": self.shaft_radius}

    def describe_limits(self, arm: Arm) -> dict[str, Any]:
        """Return the joint limits and the arm kinematics used for a result, for its ``config``; in rad and m.

        Parameters
        ----------
        arm
            ``classic`` or ``si``: the kinematics of the outer arm.
        """
        return {
            "limits_from": self.limits_from,
            "limits": {name: pair.tolist() for name, pair in zip(self.joint_names, self.limits, strict=True)},
            "arm": arm,
            "roll_offset": self.roll_offset,
        }

    def skeleton(self, joints: ArrayLike) -> Float64:
        """Compute the points of a skeleton of the instrument in one configuration, for drawing.

        The points are: points along the shaft from its proximal to its distal end, at most a centimetre apart; the
        origins of the joints from the wrist to the jaws (pitch axis, yaw axis); the jaw tips. All but the tips form
        one polyline, and each tip is connected to its last point.

        Parameters
        ----------
        joints : (J,)
            Joint values.

        Returns
        -------
        (K, 3)
            Points in the root link's frame, m; the last ``len(jaw_tips)`` are the tips.
        """
        values = self._values(joints)
        points = [np.empty((0, 3))]
        if self.shaft is not None:
            count = max(2, int(np.ceil(self.shaft.length / _SKELETON_STEP)) + 1)
            along = np.linspace(self.shaft.proximal_end, self.shaft.distal_end, count)
            points.append(self.shaft.point + along[:, None] * self.shaft.direction)
        hinges = self.hinges
        if hinges:
            points.append(self.chain.forward(values, hinges)[..., :3, 3])
        points.append(self.tips(values))
        return np.concatenate(points)

    @property
    def hinges(self) -> list[int]:
        """List the joints from the first moving one to the jaws, without those at the origin of their parent joint."""
        last = self.jaw_tips[0].link if self.jaw_tips else len(self.links) - 1
        hinges: list[int] = []
        for index in self.chain.path(self.link_joints[last]):
            joint = self.chain.joints[index]
            coincident = joint.motion != "prismatic" and not np.any(joint.parent_from_joint[:3, 3])
            if (joint.moves and not hinges) or (hinges and not coincident):
                hinges.append(index)
        return hinges

    @property
    def shaft_radius(self) -> float | None:
        """Radius of the shaft, m; None without a straight shaft."""
        return None if self.shaft is None else self.shaft.radius

    @cached_property
    def reach(self) -> float:
        """Largest distance of a vertex below the root link from the root link's origin, all joints at zero, m."""
        poses = self.forward(np.zeros(len(self.joint_names)))
        below = [k for k, joint in enumerate(self.link_joints) if joint >= 0] or range(len(self.links))
        return max(
            float(np.linalg.norm(self.links[k].vertices @ poses[k, :3, :3].T + poses[k, :3, 3], axis=1).max())
            for k in below
        )

    def half_turn(self) -> Float64:
        """Return the rotation by half a turn about the roll axis, (4, 4) in the root link's frame.

        The roll axis is the root link's z axis if the shaft lies on it (the dVRK's convention), otherwise the measured
        axis of the shaft.
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

    def twin(self, camera_from_root: ArrayLike, joints: ArrayLike) -> tuple[Float64, Float64]:
        """Compute the mirror twin: the pose rolled by half a turn about the shaft, wrist pitch and yaw negated.

        If `has_twin` is true, the twin has nearly the same silhouette as the pose. The twin of the twin is the pose.

        Parameters
        ----------
        camera_from_root : (..., 4, 4)
            Pose of the root link.
        joints : (..., J)
            Joint values.

        Returns
        -------
        camera_from_root, joints
            Pose and joint values of the twin, in the same shapes.
        """
        values = self._values(joints).copy()
        for name in TWIN_JOINTS:
            if name in self.joint_names:
                values[..., self.joint_index(name)] *= -1.0
        return np.asarray(camera_from_root, dtype=np.float64) @ self.half_turn(), values
