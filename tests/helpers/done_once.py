"""What the tests let the program do once for the same input, where commands of a process of their own do it anyway.

Each of these depends on its arguments alone. The first call with them is the program's own; later ones take its result.
"""

from __future__ import annotations

import copy
import hashlib
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from cyclopts import App, core
from cyclopts.argument import Argument, ArgumentCollection

from dvrk_cmaes import Body, Instrument
from dvrk_cmaes import segment as segmentation
from dvrk_cmaes.instrument import measure
from dvrk_cmaes.runs.manifest import digest_of
from dvrk_cmaes.silhouette import prepare

_BODIES = 8
"""Most prepared instruments that are kept."""

SEGMENT_CLASSIC = segmentation.with_classic


@contextmanager
def done_once() -> Iterator[None]:
    """Assemble a command's options (15 ms), measure and prepare an instrument (200 ms), segment an image (1 s) once."""
    with pytest.MonkeyPatch.context() as patch:
        _options_assembled_once(patch)
        _instruments_measured_once(patch)
        _instruments_prepared_once(patch)
        _images_segmented_once(patch)
        yield


def _options_assembled_once(patch: pytest.MonkeyPatch) -> None:
    assemble = App.assemble_argument_collection
    known: dict[tuple[Any, ...], tuple[App, ArgumentCollection]] = {}

    def assembled(app: App, **options: Any) -> ArgumentCollection:
        key = (id(app), app.default_command, repr(app.app_stack.default_parameter), *sorted(options.items()))
        if key not in known:
            known[key] = app, assemble(app, **options)  # with the app, whose number is then not used again
        return _unused(known[key][1])

    patch.setattr(App, "assemble_argument_collection", assembled)
    patch.setattr(core, "validate_command", cache(core.validate_command))
    negatives = Argument.negatives.__get__
    names: dict[tuple[int, int], tuple[Any, Any]] = {}

    def negated(argument: Argument) -> Any:
        given = argument.parameter, argument.field_info
        key = id(given[0]), id(given[1])
        if key not in names:
            names[key] = given, negatives(argument)  # with both, whose numbers are then not used again
        return names[key][1]

    patch.setattr(Argument, "negatives", property(negated))


def _unused(options: ArgumentCollection) -> ArgumentCollection:
    """Copy options that no words of a command line have been given to."""
    copies = {id(one): copy.copy(one) for one in options}
    for one in copies.values():
        one.tokens = []
        one.children = ArgumentCollection([copies[id(child)] for child in one.children])
    return ArgumentCollection(list(copies.values()))


def _instruments_measured_once(patch: pytest.MonkeyPatch) -> None:
    with_measurements = measure.with_measurements
    known: dict[str, Instrument] = {}

    def measured(instrument: Instrument) -> Instrument:
        key = digest_of(instrument)
        if key not in known:
            known[key] = with_measurements(instrument)
        one = known[key]
        return replace(instrument, shaft=one.shaft, jaw_tips=one.jaw_tips, has_twin=one.has_twin)

    patch.setattr(measure, "with_measurements", measured)


def _instruments_prepared_once(patch: pytest.MonkeyPatch) -> None:
    prepare_body = prepare.body_of_instrument
    known: dict[str, Body] = {}

    def prepared(instrument: Instrument) -> Body:
        key = digest_of(instrument)
        if key not in known:
            if len(known) == _BODIES:
                known.pop(next(iter(known)))
            known[key] = prepare_body(instrument)
        return known[key]

    patch.setattr(prepare, "body_of_instrument", prepared)


def _images_segmented_once(patch: pytest.MonkeyPatch) -> None:
    known: dict[str, segmentation.Segmentation] = {}

    def segmented(
        image: Any, background: Any, hints: Any, instrument: Any, camera: Any, joints: Any, expected: Any
    ) -> segmentation.Segmentation:
        body = None if instrument is None else prepare.prepare(instrument)
        of_body = () if body is None else (digest_of(body.instrument), body.method)
        given = image, background, hints, of_body, camera, joints and sorted(joints.items()), expected
        key = hashlib.sha256(pickle.dumps(given)).hexdigest()
        if key not in known:
            known[key] = SEGMENT_CLASSIC(image, background, hints, instrument, camera, joints, expected)
        return replace(known[key], mask=known[key].mask.copy())

    patch.setattr(segmentation, "with_classic", segmented)


@contextmanager
def segmented_anew() -> Iterator[None]:
    """Let images be segmented each time, for tests of that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(segmentation, "with_classic", SEGMENT_CLASSIC)
        yield


def found_by_model(patch: pytest.MonkeyPatch, mask: np.ndarray, confidence: float) -> None:
    """Let a mask be what the instrument's model finds in each image."""
    found = segmentation.Segmentation(mask, confidence)
    patch.setattr("dvrk_cmaes.segment.model_masks.segment_by_model", lambda *_: found)
