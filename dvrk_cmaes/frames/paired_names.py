"""Names of the masks, images and rows of readings of one frame, as annotators and recorders call them."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.frames.coco_mask import ROBOFLOW
from dvrk_cmaes.io.short_text import listed, natural
from dvrk_cmaes.joints.rows import number_of

_ADDED = re.compile(
    rf"^(?:mask|label|seg)s?[_-]|[_-](?:mask|label|seg|gt|segmentation(?:mask)?)s?$|\.(?:png|jpe?g|bmp|tiff?)$|{ROBOFLOW.pattern}",
    re.IGNORECASE,
)
_Value = TypeVar("_Value")
# of Label Studio: counts images as they were given to it, in all projects
_TASK = re.compile(r"task-(\d+)-annotation-")


def paired(names: Iterable[str], others: Iterable[str]) -> dict[str, str]:
    """Pair names with others: equal ones, else those equal without an annotator's words, else those of equal numbers.

    Where there are as many of either, one counted from 0 and the other from 1, or one Label Studio's tasks, they are
    paired in order.

    Parameters
    ----------
    names
        Such as those of masks.
    others
        Such as those of images.

    Returns
    -------
    dict
        The other name by name; not of a name without one, or that several of either would pair with.
    """
    own, rest = list(names), others if isinstance(others, Mapping) else dict.fromkeys(others)
    if counted_apart(own, rest):
        return dict(zip(sorted(own, key=_counted), sorted(rest, key=_counted), strict=True))
    return _of_one_number(own, rest)


def named_as(frames: Iterable[str], values: Mapping[str, _Value]) -> dict[str, _Value]:
    """Return values by the names of the frames that theirs are equal to or have the number of, others by theirs."""
    met = _of_one_number([*values], dict.fromkeys(frames))
    return {met.get(name, name): value for name, value in values.items()}


def _of_one_number(own: Collection[str], rest: Collection[str]) -> dict[str, str]:
    """Pair names as in `paired`, but none in order."""
    found = {name: name for name in own if name in rest}
    for key in (_without_words, _number):
        if len(found) < len(own):
            taken = set(found.values())
            left = _unique(key, (name for name in own if name not in found))
            free = _unique(key, (name for name in rest if name not in taken))
            found |= {name: free[each] for each, name in left.items() if each in free}
    return found


def counted_apart(names: Collection[str], others: Collection[str]) -> bool:
    """Whether as many names as others are paired in order.

    Of at least three, one are counted from 0, the others from 1; or one are Label Studio's tasks, with one mask each.
    """
    if len(names) != len(others) or {*names} == {*others}:  # readings may have millions of rows
        return False
    numbers, theirs = (sorted(map(_counted, of_either)) for of_either in (names, others))
    if all(map(_TASK.match, names)) != all(map(_TASK.match, others)):
        return len({*numbers}) == len({*theirs}) == len(names)
    counts = [*range(len(numbers))], [*range(1, len(numbers) + 1)]
    return len(names) >= 3 and (numbers, theirs) in (counts, counts[::-1])


def with_names_of(
    folder: Path, masks: Mapping[str, Path], images: Iterable[str], rows: Collection[str]
) -> dict[str, str]:
    """Return by name of each mask that of the image, or of the row of readings, that it pairs with, or its own.

    Raises
    ------
    InputError
        Most masks pair with no image or row, though there are about as many images as masks; or two have the number of
        one image.
    """
    images = list(images)
    met = paired(masks, images)
    if alone := [name for name in masks if name not in met]:
        of_images = set(paired(images, rows).values())
        met |= paired(alone, [row for row in rows if row not in of_images] if of_images else rows)
        alone = [name for name in alone if name not in met]
    if 2 * len(alone) > len(masks) and len(images) > 1 and 2 * len(images) >= len(masks):
        raise InputError(
            f"{folder}: expected masks with the names or the numbers of the frames, got {listed(alone, 2)} and frames "
            f"{listed(sorted(images, key=natural), 2)}: rename them, or leave the images out"
        )
    numbers = {_number(name): name for name in images}
    for name in (name for name in alone if _number(name) in numbers.keys() - {None}):
        raise InputError(f"{masks[name]}: expected one mask for image {numbers[_number(name)]}, got several")
    return {name: met.get(name, name) for name in masks}


def with_masks_beside(names: Iterable[str]) -> list[str]:
    """List the first name that another one is without an annotator's words, and that one; none if there is no such."""
    own = dict.fromkeys(names)
    return next(([name, same] for same in own if (name := _without_words(same)) != same and name in own), [])


def _without_words(name: str) -> str:
    """Return a name without what annotators add to it."""
    while (shorter := _ADDED.sub("", name)) != name:
        name = shorter
    return name


def _number(name: str) -> int | None:
    """Return the number that a name ends in without an annotator's words; None if it does not, or if it is a task's."""
    return None if _TASK.match(name) else number_of(_without_words(name))


def _counted(name: str) -> int:
    """Return the number of a task, or that a name ends in, as of `_number`; -1 if it does not."""
    number = int(task[1]) if (task := _TASK.match(name)) else _number(name)
    return -1 if number is None else number


def _unique(key: Callable[[str], Hashable], names: Iterable[str]) -> dict[Hashable, str]:
    """Return names by their keys that are not None, without those of equal keys."""
    found: dict[Hashable, list[str]] = {}
    for name in names:
        found.setdefault(key(name), []).append(name)
    return {each: of_key[0] for each, of_key in found.items() if each is not None and len(of_key) == 1}
