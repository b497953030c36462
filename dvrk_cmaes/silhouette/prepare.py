"""Instruments prepared for rendering, each once for as long as the process lives."""

from __future__ import annotations

import threading
from functools import lru_cache

from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.silhouette import Body

_named: dict[str, Instrument] = {}
_lock = threading.RLock()


@lru_cache(maxsize=8)
def _body(instrument: Instrument) -> Body:
    return Body.prepare(instrument)


@lru_cache(maxsize=8)
def _light_body(body: Body, cell: float) -> Body:
    return body.lightened(cell)


def lightened(body: Body, cell: float) -> Body:
    """Return a body without details below ``cell`` m."""
    with _lock:
        return _light_body(body, cell)


def prepare(instrument: Instrument | str) -> Body:
    """Prepare an instrument, or a bundled one or a URDF by its name, for rendering; done once for each."""
    with _lock:
        if isinstance(instrument, str):
            if instrument not in _named:
                _named[instrument] = load_instrument(instrument)
            instrument = _named[instrument]
        return _body(instrument)
