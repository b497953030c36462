"""JSON is read strictly: nothing that could not be written again."""

from __future__ import annotations

import pytest

from dvrk_cmaes.io.json_file import parse_json


@pytest.mark.parametrize(
    ("text", "document"),
    [
        ("[1.5, -2, 1e300, true]", [1.5, -2, 1e300, True]),
        ('{"a": "\\ud83d\\ude00", "b": null}', {"a": "\N{GRINNING FACE}", "b": None}),
        ("12345678901234567890", 12345678901234567890),
        ("[12345678901234567890, 0.25, -7]", [12345678901234567890, 0.25, -7]),
    ],
)
def test_json_is_read(text: str, document: object) -> None:
    found = parse_json(text)
    assert found == document
    assert repr(found) == repr(document)  # whole numbers stay whole


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[NaN]", "NaN is no number in JSON"),
        ("[-Infinity]", "-Infinity is no number in JSON"),
        ("[1e999]", "the number 1e999 is too large"),
        (f"[{'9' * 400}.0]", "is too large"),
        (f"[{'9' * 30}]", "a whole number of 30 digits is too large"),
        ('["\\ud800"]', "half of a surrogate pair in a text"),
        ('{"\\udfff": 1}', "half of a surrogate pair in a text"),
    ],
)
def test_other_than_json_is_refused(text: str, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        parse_json(text)
