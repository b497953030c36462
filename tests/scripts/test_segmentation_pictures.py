"""``scripts/segmentation.py``, ``pictures --drawn`` and ``fit``: pictures with exact masks, weights fitted to them."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.special import expit

if TYPE_CHECKING:
    from measure.pictures import Picture

Report = Callable[..., dict[str, list[dict[str, Any]]]]


@pytest.fixture
def picture(scripts_on_path: None, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], Picture]:
    """Draw the picture of a seed in a small world."""
    from measure import drawn_pictures
    from worlds.table import World

    world = World(0, (320, 240), 1.6, "none", 0.12, "lnd", "left", "classic", 30, 50, "colour", "none", 1, "easy")
    monkeypatch.setattr(drawn_pictures, "drawn_worlds", lambda: [world])
    return drawn_pictures.drawn_picture


@pytest.fixture
def report(
    picture: Callable[[int], Picture], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Report:
    """Run a command of scripts/segmentation.py on drawn pictures of the small world, and return its report."""

    def run(*arguments: str) -> dict[str, list[dict[str, Any]]]:
        monkeypatch.setattr("sys.argv", ["segmentation.py", *arguments, "--json"])
        assert import_module("segmentation").main() == 0
        found: dict[str, list[dict[str, Any]]] = json.loads(capsys.readouterr().out)
        return found

    return run


def test_a_drawn_picture_shows_what_its_mask_says(picture: Callable[[int], Picture]) -> None:
    drawn, again, other = picture(1), picture(1), picture(2)
    (tool,) = drawn.tools
    assert drawn.image.shape == (240, 320, 3)
    assert tool.shape == (240, 320)
    assert np.array_equal(drawn.image, again.image)
    assert not np.array_equal(drawn.image, other.image)
    assert drawn.shows(tool) == 1
    inside, outside = (drawn.image[where].mean(axis=0) for where in (tool, ~tool))
    assert np.abs(inside - outside).max() > 10


def test_drawn_pictures_are_measured(report: Report) -> None:
    found = report("pictures", "none", "--groups", "", "--drawn", "2")
    (row,) = found["pictures"]
    assert (row["group"], row["half"], row["pictures"], row["with truth"]) == ("drawn", "other", 2, 2)
    right = [each["right"] for each in found["each"]]
    assert row["right, mean"] == pytest.approx(np.mean(right))
    assert row["right, least"] == min(right)
    assert max(right) > 0.8
    assert all(0 <= each["confidence"] <= 1 for each in found["each"])


def test_weights_are_those_by_which_candidates_were_right(monkeypatch: pytest.MonkeyPatch, report: Report) -> None:
    truth = np.array([2.0, -1.0, 0.0, 1.0, 0.5, -0.5])

    def candidates(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        measures = 2 * rng.standard_normal((count, 5))
        chance = expit(np.c_[measures, np.ones(count)] @ truth)
        return measures, (rng.random(count) < chance).astype(float)

    segmentation = import_module("segmentation")
    monkeypatch.setattr(segmentation, "drawn_candidates", candidates)
    found = report("fit", "2000")
    weights = np.array([float(text) for text in found["weights"][0]["weights"].split(",")])
    assert np.abs(weights - truth).max() < 0.4
    for row in found["confidence"]:
        low, high = (float(text) for text in row["confidence"].split(" to "))
        assert low - 0.05 < row["right"] < high + 0.05
    assert sum(row["number"] for row in found["confidence"]) == 4000


def test_candidates_of_drawn_pictures_are_told_right_or_wrong(
    report: Report, picture: Callable[[int], Picture]
) -> None:
    measures, right = import_module("segmentation").drawn_candidates(1, 1)
    assert measures.shape == (len(right), 5)
    assert set(right) <= {0.0, 1.0}
    assert right.any()


@pytest.mark.usefixtures("scripts_on_path")
def test_fit_needs_a_number(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["segmentation.py", "fit", "many"])
    assert import_module("segmentation").main() == 2
    assert "fit: expected a number of pictures, got many" in capsys.readouterr().err
