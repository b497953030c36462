"""What an instrument looks like: colours on both sides of its outline, and how they change across it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dvrk_cmaes.track.colour_model import ColourModel
from dvrk_cmaes.track.edge_model import EdgeModel


@dataclass(frozen=True, eq=False)
class Appearance:
    """Models of the colours and of the edges, of the same parts of the instrument."""

    colours: ColourModel
    edges: EdgeModel

    def mixed(self, other: Appearance, share: float) -> Appearance:
        """Return the appearance with a share of another one."""
        return Appearance(self.colours.mixed(other.colours, share), self.edges.mixed(other.edges, share))

    def checkpoint(self) -> dict[str, dict[str, str]]:
        """Return both as text."""
        return {"colours": self.colours.checkpoint(), "edges": self.edges.checkpoint()}

    @staticmethod
    def restored(saved: Mapping[str, Mapping[str, str]]) -> Appearance:
        """Return the appearance of `checkpoint`; KeyError, TypeError or ValueError if it is not one."""
        return Appearance(ColourModel.restored(saved["colours"]), EdgeModel.restored(saved["edges"]))
