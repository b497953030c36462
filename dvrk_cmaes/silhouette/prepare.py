"""Instruments prepared for rendering, cached for the lifetime of the process."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from dvrk_cmaes.instrument import Instrument, load_instrument
from dvrk_cmaes.io.arguments import check_type
from dvrk_cmaes.silhouette import Body

_named: dict[str, Instrument] = {}
_lock = threading.RLock()


@lru_cache(maxsize=8)
def body_of_instrument(instrument: Instrument) -> Body:
    """Return the body of a loaded instrument; cached. The caller has the lock."""
    return Body.prepare(instrument)


@lru_cache(maxsize=8)
def _decimated_body(body: Body, cell: float) -> Body:
    return body.decimated(cell)


@lru_cache(maxsize=8)
def _body_by(body: Body, method: str) -> Body:
    return replace(body, method=method)


def body_by(body: Body, method: str) -> Body:
    """Return the same body, rendered by a method of ``silhouette.METHODS``; cached."""
    with _lock:
        return body if body.method == method else _body_by(body, method)


def decimated_body(body: Body, cell: float) -> Body:
    """Return a body whose meshes are decimated on a grid with cells of ``cell`` m; cached."""
    with _lock:
        return _decimated_body(body, cell)


def prepare(instrument: Instrument | Body | str | Path) -> Body:
    """Prepare an instrument for rendering, given itself, by a bundled name or by the path of its URDF; cached.

    A body is returned as it is.

    Parameters
    ----------
    instrument
        A bundled instrument's name, a URDF's path, a loaded `Instrument`, or a prepared `Body`.

    Raises
    ------
    InputError
        Something else was given, or the instrument cannot be loaded.
    """
    if isinstance(instrument, Body):
        return instrument
    expected = "a bundled instrument's name, the path of a URDF, an Instrument or a Body"
    check_type("instrument", instrument, (Instrument, str, Path), expected)
    with _lock:
        if not isinstance(instrument, Instrument):
            name = str(instrument)
            if name not in _named:
                _named[name] = load_instrument(name)
            instrument = _named[name]
        return body_of_instrument(instrument)
