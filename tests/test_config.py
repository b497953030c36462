"""Settings files: named values replace defaults; unknown names, other types and invalid values are refused."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from dvrk_cmaes import EstimateConfig, InputError
from dvrk_cmaes.config import REMOVED
from dvrk_cmaes.io.toml_file import leaves, read_config, updated
from dvrk_cmaes.pose.config_check import check_config


@dataclass(frozen=True)
class Inner:
    count: int = 3
    share: float = 0.5
    on: bool = True


@dataclass(frozen=True)
class Tree:
    name: str = "cmaes"
    inner: Inner = field(default_factory=Inner)


def message(values: dict[str, object]) -> str:
    with pytest.raises(InputError) as caught:
        updated(Tree(), values, where="own.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"inner": {"cuont": 4}}, "own.toml: unknown key inner.cuont; the nearest known are inner.count, "),
        ({"count": 4}, "own.toml: unknown key count; the nearest known "),
        ({"inner": {"count": 4.0}}, "own.toml: inner.count: expected a whole number, got 4.0"),
        ({"inner": {"count": True}}, "own.toml: inner.count: expected a whole number, got True"),
        ({"inner": {"share": "1"}}, "own.toml: inner.share: expected a number, got '1'"),
        ({"inner": {"on": 1}}, "own.toml: inner.on: expected true or false, got 1"),
        ({"name": 1}, "own.toml: name: expected text in quotes, got 1"),
        ({"inner": 1}, "own.toml: inner: expected a table, got 1"),
        ({"name": {"a": 1}}, "own.toml: name: expected text in quotes, got {'a': 1}"),
        ({"inner": {"count": 10**30}}, "own.toml: inner.count: expected a whole number of at most 64 bits, got 1000"),
        ({"inner": {"share": 10**400}}, "own.toml: inner.share: expected a number, got 1000"),
        ({"inner": 10**400}, "own.toml: inner: expected a table, got 1000"),
        ({"a\nb": 1}, "own.toml: unknown key a\\nb; the nearest known are "),
    ],
)
def test_unknown_name_or_other_type_is_refused(values: dict[str, object], expected: str) -> None:
    assert message(values).startswith(expected)


def test_removed_setting_is_refused_with_what_replaces_it() -> None:
    assert len(REMOVED) == len(REMOVED.keys() - dict(leaves(EstimateConfig())))
    for key, instead in REMOVED.items():
        table, name = key.split(".")
        with pytest.raises(InputError, match=f"own.toml: {key} is no longer a setting: {instead}"):
            updated(EstimateConfig(), {table: {name: 1}}, where="own.toml")


def test_every_setting_can_be_set_by_its_name(tmp_path: Path) -> None:
    lines = []
    for key, value in leaves(EstimateConfig()):
        lines.append(f"{key} = {str(value).lower() if isinstance(value, bool) else repr(value)}")
    path = tmp_path / "all.toml"
    path.write_text("\n".join(lines))
    assert read_config(path, EstimateConfig()) == EstimateConfig()
    assert len(lines) > 30


@pytest.mark.parametrize(("text", "expected"), [("[search", "no valid TOML"), ("a = 1\na = 2", "no valid TOML")])
def test_invalid_toml_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=expected) as caught:
        read_config(path, Tree())
    assert str(caught.value).startswith(f"{path}: ")


def test_defaults_are_valid() -> None:
    check_config(EstimateConfig())


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"search": {"samples": 0}}, "search.samples: expected a number above 0, got 0"),
        ({"search": {"method": "cmeas"}}, "search.method: expected one of cmaes, "),
        ({"search": {"free_share": 1.5}}, "search.free_share: expected a share, at most 1, got 1.5"),
        ({"refine": {"derivatives": "difference"}}, "refine.derivatives: expected one of differences, "),
        ({"refine": {"outline": {"blur": -1.0}}}, "refine.outline.blur: expected a number above 0, got -1"),
        ({"distance_field": "fmn"}, "distance_field: expected one of fmm, "),
        ({"decay_px": float("nan")}, "decay_px: expected a finite number, got nan"),
        ({"weights": {"mse": -0.1}}, "weights.mse: expected a number of at least 0, got -0.1"),
        ({"readings": {"jaw_deg": 0}}, "readings.jaw_deg: expected a number above 0, got 0"),
        ({"seed": -1}, "seed: expected a number of at least 0, got -1"),
        ({"threads": 0}, "threads: expected a number above 0, got 0"),
        (
            {"search": {"detail_m": 1e-308}},
            "search.detail_m: expected a number from",
        ),
        (
            {"refine": {"outline": {"cauchy": 1e308}}},
            "refine.outline.cauchy: expected a number from 1e-09 to 1000000, got",
        ),
        (
            {"refine": {"outline": {"blur": 1e308}}},
            "refine.outline.blur: expected a number from 1e-09 to 100, got 1e+308",
        ),
        ({"refine": {"outline": {"lines_per_pixel": 2**63 - 1}}}, "refine.outline.lines_per_pixel: expected a number"),
        ({"search": {"width_px": 1}}, "search.width_px: expected a number from 10 to 10000, got 1"),
        ({"seed": 2**63 - 1}, "seed: expected a number from 1e-09 to 4294967295, got 9223372036854775807"),
        ({"lookat": {"tilt": 1.6}}, "lookat.tilt: expected less than pi/2"),
        ({"lookat": {"near": 0.5}}, "lookat.near: expected less than lookat.far"),
    ],
)
def test_invalid_settings_are_refused(values: dict[str, object], expected: str) -> None:
    with pytest.raises(InputError) as caught:
        check_config(updated(EstimateConfig(), values, where=""))
    assert str(caught.value).startswith(f"config: {expected}")


def test_zero_weights_and_zero_seed_are_valid() -> None:
    config = EstimateConfig(seed=0)
    check_config(replace(config, weights=replace(config.weights, cylinder=0.0, keypoints=0.0)))
