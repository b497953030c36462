"""Articulated instruments read from a URDF: link meshes, kinematic chain, shaft and jaw tips."""

from __future__ import annotations

from dvrk_cmaes.instrument.kinematics import Chain, Joint
from dvrk_cmaes.instrument.model import Instrument, JawTip, Link, Shaft
from dvrk_cmaes.instrument.urdf import bundled_names, load_instrument

__all__ = ["Chain", "Instrument", "JawTip", "Joint", "Link", "Shaft", "bundled_names", "load_instrument"]
