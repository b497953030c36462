"""Cables of a session: which model is used, what it corrects, and that each frame is corrected by the others only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dvrk_cmaes.calibration.cables import MARGIN, CableFit, CableSession, SessionCables, fit_cables
from dvrk_cmaes.joints.cable_prior import cable_prior, measured_cables, play_of

NAMES = ("roll", "wrist_pitch", "wrist_yaw", "jaw")
PRIOR = cable_prior(NAMES)
SEEN = np.deg2rad([2.0, 1.5, 1.5, 1.5])
"""Standard deviations of a frame's joints as an outline tells them."""

USUAL_NOISE = np.deg2rad([3.0, 3.5, 3.5, 5.0])
OFFSET_STD = np.deg2rad([20.0, 10.0, 10.0, 15.0])


def session(
    readings: np.ndarray, errors: np.ndarray, rng: np.random.Generator, *, ordered: bool = True
) -> CableSession:
    """Frames a tenth of a second apart, whose errors (N, C) are seen with noise."""
    frames, count = readings.shape
    seen = errors + SEEN * rng.standard_normal(errors.shape)
    information = np.tile(np.diag(SEEN**-2.0), (frames, 1, 1))
    return CableSession(
        names=NAMES,
        readings=readings,
        times=0.1 * np.arange(frames) if ordered else np.full(frames, np.nan),
        play=play_of(readings, PRIOR.model.width) if ordered else None,
        information=information,
        vector=np.einsum("nij,nj->ni", information, seen),
        offsets=np.zeros(count),
        offset_std=OFFSET_STD,
        noise=USUAL_NOISE,
    )


def waves(frames: int, rng: np.random.Generator) -> np.ndarray:
    """Readings (N, C) of joints that move to and fro."""
    time = 0.1 * np.arange(frames)[:, None]
    return np.asarray(0.6 * np.sin(2 * np.pi * time / rng.uniform(2, 5, 4) + rng.uniform(0, 6, 4)))


@pytest.fixture(scope="module")
def pulled() -> tuple[CableSession, np.ndarray, CableFit]:
    """A session of 60 frames whose joints follow by the cables of a real arm, its true errors, and the fit."""
    rng = np.random.default_rng(3)
    readings = waves(60, rng)
    errors = measured_cables(NAMES)[1].errors(readings, play_of(readings, measured_cables(NAMES)[1].width))
    made = session(readings, errors, rng)
    return made, errors, fit_cables(made, PRIOR)[0]


def left_of(errors: np.ndarray, fit: CableFit) -> np.ndarray:
    """Root mean square (C,) of what the corrections and one offset a joint leave of the errors."""
    return np.asarray(np.std(errors - fit.correction.values, axis=0))


def test_cables_are_found_and_predict_each_frame_from_the_others(
    pulled: tuple[CableSession, np.ndarray, CableFit],
) -> None:
    _, errors, fit = pulled
    assert {"coupling", "play"} <= {*fit.parts}
    assert fit.gain > 4
    assert (left_of(errors, fit)[1:3] < 0.4 * np.std(errors, axis=0)[1:3]).all()


def test_a_frame_has_no_part_in_its_own_correction(pulled: tuple[CableSession, np.ndarray, CableFit]) -> None:
    made, _, fit = pulled
    information, vector = made.information.copy(), made.vector.copy()
    information[30], vector[30] = 0.0, 0.0
    without = fit_cables(replace(made, information=information, vector=vector), PRIOR)[0]
    np.testing.assert_allclose(without.correction.values[30], fit.correction.values[30], atol=np.deg2rad(0.3))


def test_without_order_only_coupling_is_used(pulled: tuple[CableSession, np.ndarray, CableFit]) -> None:
    made, errors, _ = pulled
    fit, alone = fit_cables(replace(made, times=np.full(60, np.nan), play=None), PRIOR)
    assert fit.parts == alone.parts == ("coupling",)
    assert (left_of(errors, fit)[1:3] < np.std(errors, axis=0)[1:3]).all()


def test_independent_noise_in_unordered_frames_keeps_one_offset() -> None:
    rng = np.random.default_rng(1)
    errors = np.deg2rad(3.0) * rng.standard_normal((40, 4))
    fit, _ = fit_cables(session(rng.uniform(-0.8, 0.8, (40, 4)), errors, rng, ordered=False), PRIOR)
    assert fit.parts == ()


def test_frames_that_hardly_show_cables_have_their_correction_only_before_the_margin_holds(
    pulled: tuple[CableSession, np.ndarray, CableFit],
) -> None:
    made, errors, _ = pulled
    weak = replace(made, information=made.information / 700, vector=made.vector / 700)
    most_likely, fit = fit_cables(weak, PRIOR, 0.0)[0], fit_cables(weak, PRIOR)[0]
    assert 0 < most_likely.gain < MARGIN
    assert (left_of(errors, most_likely)[1:3] < np.std(errors, axis=0)[1:3]).all()
    assert fit.parts == ()
    assert not fit.correction.values.any()


def in_words(made: CableSession) -> list[str]:
    """What the report says of a session's cables; nothing if offsets explain them."""
    found = SessionCables.of(fit_cables(made, PRIOR))
    return [] if found is None else list(found.in_words())


def test_nothing_is_claimed_of_a_joint_whose_reading_never_changes() -> None:
    rng = np.random.default_rng(3)
    readings = waves(60, rng)
    readings[:, NAMES.index("jaw")] = 0.5
    errors = measured_cables(NAMES)[1].errors(readings, play_of(readings, measured_cables(NAMES)[1].width))
    texts = in_words(session(readings, errors, rng))
    assert any("wrist_yaw" in text for text in texts)
    assert not any(text.startswith(("jaw stays", "play of jaw", "jaw drags")) for text in texts)
