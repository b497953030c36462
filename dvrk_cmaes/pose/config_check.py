"""Check of the values of all settings before an estimate."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any

from dvrk_cmaes.config import EstimateConfig, Limits
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.evidence.outline_noise import FIELDS
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.pose.refine import DERIVATIVES
from dvrk_cmaes.pose.search import METHODS as SEARCHES
from dvrk_cmaes.silhouette import METHODS as SILHOUETTES

_NAMES: dict[str, Collection[str]] = {
    "search.method": SEARCHES,
    "refine.derivatives": DERIVATIVES,
    "distance_field": FIELDS,
    "silhouette.method": SILHOUETTES,
}
_USUAL = Limits()  # of numbers without limits of their own: their squares neither overflow nor vanish


def check_config(config: EstimateConfig) -> None:
    """Check the values of all settings.

    Raises
    ------
    InputError
        These are no settings; a setting is an unknown method (the message lists the known ones, most similar first); or
        a number is not finite, negative, outside its range, or zero where only positive values are allowed.
    """
    check_type("config", config, EstimateConfig, "an EstimateConfig")
    _check_values(config)


@lru_cache(maxsize=8)
def _check_values(config: EstimateConfig) -> None:
    """Check the values of all settings, once of those of many frames."""
    for key, value, limits in _settings(config):
        where = f"config: {key}"
        if key in _NAMES and value not in _NAMES[key]:
            names = ", ".join(nearest_first(str(value), _NAMES[key]))
            raise InputError(f"{where}: expected one of {names}, got {value!r}")
        if isinstance(value, bool | str):
            continue
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{where}: expected a finite number, got {value}")
        if value < 0 or (value == 0 and not limits.zero):
            least = "a number of at least 0" if limits.zero else "a number above 0"
            raise InputError(f"{where}: expected {least}, got {shown(value)}")
        if value > limits.most or 0 < value < limits.least:
            raise InputError(
                f"{where}: expected a number from {limits.least:g} to {limits.most:.10g}, got {shown(value)}"
            )
        if limits.share and value > 1:
            raise InputError(f"{where}: expected a share, at most 1, got {value:g}")
    look = config.lookat
    if look.tilt >= math.pi / 2:
        raise InputError(f"config: lookat.tilt: expected less than pi/2 (1.5708) rad, got {look.tilt:g}")
    if look.near >= look.far:
        raise InputError(f"config: lookat.near: expected less than lookat.far, {look.far:g} m, got {look.near:g}")


def _settings(tree: Any, table: str = "", limits: Limits = _USUAL) -> Iterator[tuple[str, Any, Limits]]:
    """Yield all settings of a tree of dataclasses as ``table.key``, value and limits, of the table if it has any."""
    for field in fields(tree):
        value, own = getattr(tree, field.name), field.metadata.get("limits", limits)
        if is_dataclass(value):
            yield from _settings(value, f"{table}{field.name}.", own)
        else:
            yield f"{table}{field.name}", value, own
