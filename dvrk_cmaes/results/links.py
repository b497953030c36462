"""Poses of an instrument's links in the camera, from a pose and joint values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from numpy.typing import ArrayLike

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.geometry import Float64


class NamedLink(Protocol):
    """A link with a name."""

    @property
    def name(self) -> str:
        """Name in the URDF."""


class LinkModel(Protocol):
    """Forward kinematics of an instrument, as `dvrk_cmaes.Instrument` has it."""

    @property
    def name(self) -> str:
        """Name of the instrument."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the J joints."""

    @property
    def links(self) -> Sequence[NamedLink]:
        """The L links with geometry."""

    def forward(self, joints: ArrayLike) -> Float64:
        """Compute root_from_link (L, 4, 4), m, from joint values (J,), rad.

        Parameters
        ----------
        joints
            Joint values (J,), rad, in the order of the model's joints.
        """


def camera_from_links(
    camera_from_root: Float64, joints: Mapping[str, float], model: LinkModel | None
) -> dict[str, Float64]:
    """Return camera_from_link (4, 4), m, of each link by name, from a pose (4, 4) and joints by name, rad.

    Raises
    ------
    InputError
        There is no model, or a joint of it has no value.
    """
    if model is None:
        raise InputError("links: expected the instrument of a result that was read from a file, got none")
    missing = [name for name in model.joint_names if name not in joints]
    if missing:
        raise InputError(f"links: joints: expected a value of {missing[0]} of {model.name}, got {', '.join(joints)}")
    poses = camera_from_root @ model.forward([joints[name] for name in model.joint_names])
    return {link.name: pose for link, pose in zip(model.links, poses, strict=True)}
