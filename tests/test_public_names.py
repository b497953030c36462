"""The names of `dvrk_cmaes`: they can be imported, and what users have to make or get from a function is among them."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any, get_args, get_type_hints

import pytest

import dvrk_cmaes

PUBLIC = {name: getattr(dvrk_cmaes, name) for name in dvrk_cmaes.__all__ if name != "__version__"}
FUNCTIONS = [value for value in PUBLIC.values() if inspect.isfunction(value)]
USED = (
    dvrk_cmaes.EstimateConfig,
    dvrk_cmaes.Result,
    dvrk_cmaes.SessionCalibration,
    dvrk_cmaes.SessionFrame,
    dvrk_cmaes.SolvedSession,
    dvrk_cmaes.TrackResult,
    dvrk_cmaes.Tracker,
)
"""Classes whose objects users make or get, and look into."""
DRAWN = (*USED, dvrk_cmaes.Renderer)
MADE = [
    kind.__init__ for kind in (dvrk_cmaes.SessionFrame, dvrk_cmaes.ToolInFrame, dvrk_cmaes.Tracker, dvrk_cmaes.Keyframe)
]
"""Constructors that users call."""


def classes_in(annotation: Any) -> Iterator[type]:
    """Give the package's own classes in an annotation."""
    if inspect.isclass(annotation) and annotation.__module__.startswith("dvrk_cmaes."):
        yield annotation
    for part in get_args(annotation):
        yield from classes_in(part)


def annotations_of(kind: type) -> Iterator[Callable[..., Any]]:
    """Give the constructor, properties and own methods of a class."""
    internal = {"model"} if kind is dvrk_cmaes.SessionCalibration else set()
    for name, member in vars(kind).items():
        if (name == "__init__" or not name.startswith("_")) and name not in internal:
            function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
            if inspect.isfunction(function):
                yield function
    if dataclasses.is_dataclass(kind):
        yield kind.__init__


def qualified_name(function: Callable[..., Any]) -> str:
    """Name a test by its function, which has the same name in every process."""
    return function.__qualname__


def required_classes(function: Callable[..., Any]) -> set[type]:
    """Give the package's own classes that a caller has to hand over."""
    required = {
        name for name, one in inspect.signature(function).parameters.items() if one.default is inspect.Parameter.empty
    }
    hints = get_type_hints(function, localns=PUBLIC)
    return {kind for name, hint in hints.items() if name in required for kind in classes_in(hint)}


@pytest.mark.parametrize("function", [*FUNCTIONS, *MADE], ids=qualified_name)
def test_what_a_caller_has_to_make_is_public(function: Callable[..., Any]) -> None:
    met = required_classes(function)
    assert {kind.__name__ for kind in met} <= set(PUBLIC), function.__qualname__
    assert all(PUBLIC[kind.__name__] is kind for kind in met)


@pytest.mark.parametrize("function", FUNCTIONS, ids=qualified_name)
def test_what_a_function_returns_is_public(function: Callable[..., Any]) -> None:
    returned = set(classes_in(get_type_hints(function, localns=PUBLIC)["return"]))
    assert {kind.__name__ for kind in returned} <= set(PUBLIC)


def takes_arrays(function: Callable[..., Any]) -> bool:
    """Whether a function takes or returns arrays."""
    return any("ndarray" in str(hint) for hint in get_type_hints(function, localns=PUBLIC).values())


@pytest.mark.parametrize(
    "function",
    [f for f in [*FUNCTIONS, *(f for kind in DRAWN for f in annotations_of(kind))] if takes_arrays(f)],
    ids=qualified_name,
)
def test_arrays_have_their_shapes_stated(function: Callable[..., Any]) -> None:
    owner = getattr(dvrk_cmaes, function.__qualname__.partition(".")[0])
    stated = f"{inspect.getdoc(owner)} {inspect.getdoc(function)}"
    assert re.search(r"\([A-Z0-9 +]+, [A-Z0-9 ,]*\)", stated), "no shape such as (H, W) or (4, 4)"


def test_public_names_are_listed() -> None:
    assert dir(dvrk_cmaes) == sorted(dvrk_cmaes.__all__)


def test_unknown_name_is_refused() -> None:
    with pytest.raises(AttributeError, match=r"^module 'dvrk_cmaes' has no attribute 'Nothing'$"):
        dvrk_cmaes.__getattr__("Nothing")


# the docstrings of which the site's page is made

INTERNAL = {"from_document", "ViewDocument.of", "SessionCalibration.model"}
"""Methods that take objects which users do not have."""


def documented() -> list[Callable[..., Any]]:
    """Give the public functions, and the public methods of the public classes."""
    members = [
        getattr(member, "__func__", member)
        for kind in PUBLIC.values()
        if inspect.isclass(kind)
        for name, member in vars(kind).items()
        if not name.startswith("_")
    ]
    methods = [member for member in members if inspect.isfunction(member)]
    return [f for f in [*FUNCTIONS, *methods] if not {f.__name__, f.__qualname__} & INTERNAL]


@pytest.mark.parametrize("function", documented(), ids=qualified_name)
def test_parameters_are_listed_one_by_one(function: Callable[..., Any]) -> None:
    names = [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]
    text = inspect.getdoc(function) or ""
    section = re.search(r"^Parameters\n-+\n((?:.+\n?)*)", text, flags=re.MULTILINE)
    listed = re.findall(r"^(\w+)(?: : .+)?$", section[1] if section else "", flags=re.MULTILINE)
    assert listed == names
