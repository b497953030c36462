"""What all frames of a session show together: frames that disagree on the base, arms with each other's masks or joints.

Of two arms, either the joints found for each tool are nearer to the readings of the other, or both are not ok in the
same frames. Where a mask was found in an image, that is looked at again where most frames expect the instrument.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np

from dvrk_cmaes.calibration.endoscope import Steered
from dvrk_cmaes.calibration.model import ecm_readings
from dvrk_cmaes.evaluate.consistency import spread_of_bases
from dvrk_cmaes.frames.frame import FrameFiles, read_frame
from dvrk_cmaes.io.json_file import read_json_object, write_json
from dvrk_cmaes.io.short_text import listed
from dvrk_cmaes.pose.doubts import BASE_APART, base_apart
from dvrk_cmaes.results.folder import found_masks, result_path
from dvrk_cmaes.results.result import Result
from dvrk_cmaes.runs.frame import ArmInSession, estimated, failed_outcome
from dvrk_cmaes.runs.pool import Notice

_LEAST_FRAMES: Final = 3
_FACTOR: Final = 2.0  # of the squared distances from the own readings and from those of the other tool
_JOINTS: Final = ("wrist_pitch", "wrist_yaw", "jaw")
_LEAST_FOLLOWED: Final = 15  # frames at the end of a recording
_LEAST_OFF: Final = np.deg2rad(30)  # from the own readings there, of both tools together; more than cables explain
_FEWEST: Final = 6  # frames with a pose, by which others are expected
_LEAST_SHARED: Final = 0.75  # share of the frames in which one of two tools is not ok that must not be ok for both


def exchanged_arms(found: Mapping[str, Mapping[str, Result]], *, followed: bool = False) -> list[str]:
    """Say which arms seem to have each other's masks or readings, given the results of each by frame.

    Arguments as of `exchanged_tools`, which asks for the joints; masks are suspected where both tools are not ok.
    """
    return exchanged_tools(found, followed=followed) or exchanged_masks(found)


def exchanged_masks(found: Mapping[str, Mapping[str, Result]]) -> list[str]:
    """Say in which frames two arms may have each other's masks: both are not ok in nearly the same frames.

    Parameters
    ----------
    found
        Results by arm and frame.
    """
    texts = []
    for first, second in combinations(found, 2):
        names = [name for name in found[first] if name in found[second] and found[first][name].readings]
        bad = [{name for name in names if found[arm][name].status != "ok"} for arm in (first, second)]
        both = [name for name in names if name in bad[0] & bad[1]]
        if len(both) >= _LEAST_FRAMES and len(both) >= _LEAST_SHARED * len(bad[0] | bad[1]):
            evidence = f"neither is ok in {len(both)} of {len(names)} frames ({listed(both)})"
            texts.append(f"{first} and {second}: {evidence}; their masks may be exchanged there")
    return texts


def exchanged_tools(found: Mapping[str, Mapping[str, Result]], *, followed: bool = False) -> list[str]:
    """Say which tools seem to be exchanged, given the results of each arm by frame; empty without any.

    Two tools are compared in the frames in which both were found and read. The readings pull a pose towards them, so
    joints that are clearly nearer to the readings of the other tool are no accident. Tools that are ``followed``, whose
    frames are in order, may be exchanged from a frame on to the end: that from which on the distances from the own
    readings exceed the others' most.
    """
    least, least_off = (_LEAST_FOLLOWED, _LEAST_OFF**2) if followed else (_LEAST_FRAMES, 0.0)
    texts = []
    for first, second in combinations(found, 2):
        distances = _distances(found[first], found[second])
        if len(distances) < least:
            continue
        values, start = np.array(list(distances.values())), 0
        if followed:
            excess = np.cumsum((values[:, 0] - values[:, 1])[::-1])[::-1]
            start = int(np.argmax(excess[: len(values) - least + 1]))
        own, other = np.median(values[start:], axis=0)
        if own > _FACTOR * other and own > least_off:
            degrees = f"{np.degrees(np.sqrt(other)):.0f} instead of {np.degrees(np.sqrt(own)):.0f} deg"
            nearer = f"the joints found for each are nearer to the readings of the other ({degrees})"
            since = f" from frame {list(distances)[start]} on" if followed else ""
            texts.append(f"{first} and {second}: {nearer}; their masks or readings seem to be exchanged{since}")
    return texts


def _distances(first: Mapping[str, Result], second: Mapping[str, Result]) -> dict[str, tuple[float, float]]:
    """Return the squared distances of two tools' joints from the own and the other's readings, rad^2, by frame.

    Of frames in which both were found and read.
    """
    found = {}
    for name, one in first.items():
        other = second.get(name)
        if other is not None and all((one.joints, one.readings, other.joints, other.readings)):
            tools = one.joints, other.joints, one.readings, other.readings
            at, read = np.split(np.array([[own.get(joint, np.nan) for joint in _JOINTS] for own in tools]), 2)
            found[name] = float(np.nansum((at - read) ** 2)), float(np.nansum((at - read[::-1]) ** 2))
    return found


FEWEST = 5
"""Least number of frames whose bases are compared."""

_SPREADS = 3.0  # median distances from the most central base, beyond which a frame differs


def compare_bases(out: Path, results: Mapping[str, Result], limit_deg: float) -> dict[str, Result]:
    """Return results in which frames whose base is far from the others' are doubtful, and update their files.

    Reasons of an earlier comparison are replaced, so that the files depend only on the frames that are there.
    """
    far = base_doubts(results, limit_deg)
    compared = {}
    for name, result in results.items():
        own = [reason for reason in result.reasons if not reason.startswith(BASE_APART)]
        found = (*own, *([far[name]] if name in far else ()))
        if found != result.reasons:
            result = replace(result, reasons=found, status="doubtful" if found else "ok")
            document = read_json_object(path := result_path(out, name), expected="a result")
            write_json(path, {**document, "status": result.status, "reasons": list(found)})
        compared[name] = result
    return compared


def base_doubts(results: Mapping[str, Result], limit_deg: float) -> dict[str, str]:
    """Return the reason, in words, of each frame whose base is far from the others', by name.

    Compared are the frames that were solved by themselves and have a base. Far is a rotation from the most central base
    by more than ``limit_deg`` and by more than three times the median of all frames. Where the endoscope's arm is read
    and moves, frames at one place are compared with each other.
    """
    bases = {
        name: result.camera_from_base
        for name, result in results.items()
        if result.camera_from_base is not None and result.source == "frame"
    }
    if len(bases) < FEWEST:
        return {}
    steered = Steered.of(ecm_readings([results[name].readings for name in bases]))
    places = np.zeros(len(bases), np.intp) if steered is None else steered.place
    reasons: dict[str, str] = {}
    for place in sorted(set(places[places >= 0].tolist())):
        there = [name for name, own in zip(bases, places, strict=True) if own == place]
        if len(there) < FEWEST:
            continue
        angles = spread_of_bases(np.stack([bases[name] for name in there])).angles_deg
        limit = max(limit_deg, _SPREADS * float(np.median(angles)))
        reasons |= {
            name: text
            for name, angle in zip(there, angles, strict=True)
            if (text := base_apart(float(angle), limit)) is not None
        }
    return {name: reasons[name] for name in bases if name in reasons}


def expected_elsewhere(arm: ArmInSession, results: Mapping[str, Result], notice: Notice) -> list[FrameFiles]:
    """Return the frames whose masks were found in images and do not agree with most others on where the base is.

    ``results`` are those of frames by name, each by its own image. Each frame that is returned starts where those that
    agree expect it; one in which nothing was found is among them. There are none if fewer than 70 % of them agree.
    ``notice`` takes a line that says how many they are.
    """
    from dvrk_cmaes.calibration.calibrate import in_threads
    from dvrk_cmaes.calibration.session_frame import SessionFrame
    from dvrk_cmaes.calibration.session_loop import predict_from_first
    from dvrk_cmaes.calibration.session_problem import ArmSetup

    body, method, session = arm.body, arm.method, arm.session
    images = {own.name: own for own in session.frames if own.has_image and not own.has_mask and own.prompts is None}
    frames = [
        SessionFrame(name, partial(read_frame, own, session.rig), results[name], time=own.time)
        for name, own in images.items()
        if name in results
    ]
    by_classic = method.segment is None or method.segment.model == "classic"
    if sum(not frame.lacks for frame in frames) < _FEWEST or method.session is not None or not by_classic:
        return []
    config = method.config.with_alike_masks()
    run = partial(in_threads, body, config)
    setup = ArmSetup(session.reading_series(), body.instrument, method.arm, config, run)
    expected = predict_from_first(frames, {frame.name: images[frame.name].readings for frame in frames}, setup)
    if expected:
        notice(f"images looked at again, where the others expect the instrument: {len(expected)}")
    return [replace(images[name], start=start) for name, start in expected.items()]


def expected_by_masks(arm: ArmInSession, folder: Path, notice: Notice) -> list[FrameFiles]:
    """Return the frames of `expected_elsewhere` by the masks in a folder that were found in their images."""
    frames = [with_found_masks(files, folder) for files in arm.session.frames]
    found = (estimated(arm, own) if own.has_mask else failed_outcome(arm, own, "no mask was found") for own in frames)
    results = {own.name: outcome.result for own, outcome in zip(frames, found, strict=True)}
    return expected_elsewhere(arm, results, notice)


def with_found_masks(files: FrameFiles, folder: Path) -> FrameFiles:
    """Return a frame with the masks in a folder that were found in its images, where it has no masks of its own."""
    if files.has_mask:
        return files
    masks = {path.parent.name: path for path in found_masks(folder, files.name)}
    others = {name: replace(own, mask=masks.pop(name, None)) for name, own in files.others.items()}
    return replace(files, mask=next(iter(masks.values()), None), others=others)
