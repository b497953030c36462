"""When another pose is searched for: images without support, and images that agree less than those before."""

from __future__ import annotations

from dvrk_cmaes.config import TrackConfig
from dvrk_cmaes.track.searching import Searching, is_better
from dvrk_cmaes.track.update import Fit

CONFIG = TrackConfig()


def fit(supported: float, unexplained: float = 0.0) -> Fit:
    return Fit(supported, unexplained, 500.0, 0.5, 0.0, {0: (supported, unexplained)})


def search_after(images: list[Fit | None], source: str = "mask", *, out_of_view: bool = False) -> int | None:
    """Give the number of images until the first search, None without one; the first image agrees well."""
    searching = Searching()
    searching.found(fit(0.95))
    for number, image in enumerate(images, start=1):
        if searching.missed(image, source, CONFIG, out_of_view=out_of_view):
            return number
    return None


def test_two_images_without_support_start_a_search() -> None:
    assert search_after([None] * 9) == 2
    assert search_after([fit(0.2)] * 9) == 2


def test_images_in_which_nothing_is_expected_hardly_count() -> None:
    assert search_after([None] * 30, out_of_view=True) == 20


def test_mask_that_agrees_less_than_those_before_counts_as_one_without_support() -> None:
    assert search_after([fit(0.8)] * 9) == 2
    assert search_after([fit(0.6)] * 9, source="image") == 8


def test_small_changes_of_agreement_are_usual() -> None:
    searching = Searching()
    searching.found(fit(0.95))
    assert not searching.is_weak(fit(0.9), "mask", CONFIG)
    assert searching.is_weak(fit(0.75), "mask", CONFIG)
    assert not searching.is_weak(fit(0.75), "image", CONFIG)


def test_agreement_that_lasts_becomes_usual() -> None:
    searching = Searching()
    searching.found(fit(0.95))
    for _ in range(60):
        searching.found(fit(0.83))
    assert not searching.is_worse(fit(0.75), "mask")


def test_search_without_a_better_pose_makes_the_agreement_usual() -> None:
    searching = Searching()
    searching.found(fit(0.95))
    assert searching.is_worse(fit(0.75), "mask")
    searching.settle(fit(0.75))
    assert not searching.is_worse(fit(0.75), "mask")


def test_searches_become_rarer_and_start_again_after_support() -> None:
    searching = Searching()
    searched = [k for k in range(40) if searching.missed(None, "mask", CONFIG, out_of_view=False)]
    assert searched == [1, 3, 7, 15, 31]
    searching.found(fit(0.9))
    assert not searching.missed(None, "mask", CONFIG, out_of_view=False)
    assert searching.missed(None, "mask", CONFIG, out_of_view=False)


def test_better_means_clearly_better() -> None:
    assert is_better(fit(0.9), fit(0.7))
    assert not is_better(fit(0.9), fit(0.85))
    assert not is_better(fit(0.9, 0.2), fit(0.7))
