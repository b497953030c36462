"""Check of the values of all settings before an estimate."""

from __future__ import annotations

import math
from collections.abc import Collection

from dvrk_cmaes.config import EstimateConfig
from dvrk_cmaes.errors import InputError, nearest_first
from dvrk_cmaes.evidence.distance_field import FIELDS
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.toml_file import leaves
from dvrk_cmaes.pose.refine import METHODS as REFINEMENTS
from dvrk_cmaes.pose.search import METHODS as SEARCHES
from dvrk_cmaes.silhouette import METHODS as SILHOUETTES

_NAMES: dict[str, Collection[str]] = {
    "search.method": SEARCHES,
    "refine.method": REFINEMENTS,
    "distance_field": FIELDS,
    "silhouette.method": SILHOUETTES,
}
_MAY_BE_ZERO = ("seed", "weights.", "trust.", "search.free_share", "refine.outline.noise_floor")
_LARGEST = {
    "seed": 2**32 - 1,
    "threads": 1000,
    "search.width_px": 10_000,
    "refine.width_px": 10_000,
    "refine.outline.blur": 100,
    "refine.outline.lines_per_pixel": 100,
    **{f"refine.outline.{name}_step": 1.0 for name in ("translation", "swing", "turn", "joint")},
}
_LEAST = {
    "search.width_px": 10,
    "refine.width_px": 10,
    "search.detail_m": 1e-6,
    **{f"refine.outline.{name}_step": 1e-7 for name in ("translation", "swing", "turn", "joint")},
}
_RANGE = 1e-9, 1e6  # of settings without limits of their own, against values whose squares overflow or vanish
_SHARES = (
    "search.free_share",
    "refine.small_share",
    "refine.last_share",
    "trust.least_iou",
    "trust.largest_bend_share",
    "trust.least_mode_probability",
)


def check_config(config: EstimateConfig) -> None:
    """Check the values of all settings.

    Raises
    ------
    InputError
        A setting is an unknown method (the message lists the known ones, most similar first), or a number that is not
        finite, negative, outside its range, or zero where only positive values are allowed.
    """
    for key, value in leaves(config):
        where = f"config: {key}"
        if key in _NAMES and value not in _NAMES[key]:
            names = ", ".join(nearest_first(str(value), _NAMES[key]))
            raise InputError(f"{where}: expected one of {names}, got {value!r}")
        if isinstance(value, bool | str):
            continue
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{where}: expected a finite number, got {value}")
        if value < 0 or (value == 0 and not key.startswith(_MAY_BE_ZERO)):
            least = "a number of at least 0" if key.startswith(_MAY_BE_ZERO) else "a number above 0"
            raise InputError(f"{where}: expected {least}, got {shown(value)}")
        low, high = _LEAST.get(key, _RANGE[0]), _LARGEST.get(key, _RANGE[1])
        if value > high or 0 < value < low:
            raise InputError(f"{where}: expected a number from {low:g} to {high:.10g}, got {shown(value)}")
        if key in _SHARES and value > 1:
            raise InputError(f"{where}: expected a share, at most 1, got {value:g}")
    look = config.lookat
    if look.tilt >= math.pi / 2:
        raise InputError(f"config: lookat.tilt: expected less than pi/2 (1.5708) rad, got {look.tilt:g}")
    if look.near >= look.far:
        raise InputError(f"config: lookat.near: expected less than lookat.far, {look.far:g} m, got {look.near:g}")
