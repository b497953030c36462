"""Damage to files for scripts/fuzz.py: to values of documents, words of texts, bytes, and to the place."""

from __future__ import annotations

import copy
import json
import os
import random
import re
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

Steps = tuple[Any, ...]

_ODD: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63 - 1, 2**80, -(2**63), 10**400),
    *(0.5, -0.0, 1e-308, 1e308, -1e308, float("inf"), float("-inf"), float("nan")),
    *("", "nan", "..", "/", "a/b", "\0", "\n", "\ud800", "☃", "<b>", "x" * 5000),
    *([], {}, [[]], [{}], {"a": {}}, [0] * 1000),
)
"""Values in place of others: of other types, at the ends of ranges, and as text that may do harm."""

ODD_WORDS = (
    *("nan", "inf", "-1", "0", "1e308", "-1e308", "1e-308", "1e400", "9" * 30, "9" * 5000, "2147483648"),
    *("null", "true", "", "[]", "{}", "''", "☃", "..", "/", "<", "&a", "*a", ",", ":", "- ", "\0", "\n", "\t"),
    "!!python/object/apply:os.system ['touch bang']",
)
"""Words in place of others in texts, and values of options."""


def damaged_document(text: str, chance: random.Random) -> bytes:
    """Change one to three values of a JSON document: replace, remove, rename, repeat or nest them."""
    document = json.loads(text)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        places = list(_places(document))
        if not places:
            break
        _change(document, chance.choice(places), chance)
    return json.dumps(document, ensure_ascii=True).encode()


def damaged_text(text: str, chance: random.Random) -> bytes:
    """Change a word, a line or the order of two lines of a text, or cut it off."""
    lines = text.splitlines(keepends=True)
    match chance.randrange(8):
        case 0:
            line = chance.randrange(len(lines))
            lines[line : line + 1] = lines[line : line + 1] * chance.choice((0, 2, 1000))
            return "".join(lines).encode()
        case 1:
            chance.shuffle(lines)
            return "".join(lines).encode()
        case 2:
            return text[: chance.randrange(len(text))].encode()
    word = chance.choice(list(re.finditer(r"[-+\w.]+|\W", text)))
    return (text[: word.start()] + chance.choice(ODD_WORDS) + text[word.end() :]).encode()


def damaged_bytes(data: bytes, chance: random.Random) -> bytes:
    """Flip bits, overwrite, insert, remove or repeat a range of bytes, or cut the data off."""
    place, length = chance.randrange(len(data)), chance.choice((1, 1, 4, 64, 1000))
    match chance.randrange(6):
        case 0 | 1:
            flipped = bytearray(data)
            for _ in range(chance.choice((1, 3, 20))):
                flipped[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            return bytes(flipped)
        case 2:
            return data[:place] + chance.choice((b"\xff", b"\0")) * length + data[place + length :]
        case 3:
            return data[:place] + chance.randbytes(length) + data[place:]
        case 4:
            return data[:place] + data[place + length :]
        case _:
            return data[:place]


def damage_place(path: Path, chance: random.Random) -> str:
    """Put something else than a readable file in place of a file; returns its name."""
    path.unlink(missing_ok=True)
    kind = chance.choice(("missing", "empty", "folder", "pipe", "device", "socket", "loop", "noise"))
    match kind:
        case "empty":
            path.write_bytes(b"")
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "socket":
            before = Path.cwd()
            os.chdir(path.parent)  # the name of a socket is short
            with socket.socket(socket.AF_UNIX) as end:
                end.bind(path.name)
            os.chdir(before)
        case "loop":
            path.symlink_to(path.name)
        case "noise":
            path.write_bytes(chance.randbytes(3000))
    return kind


def _places(value: Any, steps: Steps = ()) -> Iterator[Steps]:
    """Yield the way to each value inside a document, not into the middle of long lists."""
    inner = value.items() if isinstance(value, dict) else enumerate(value[:8]) if isinstance(value, list) else ()
    for key, one in inner:
        yield (*steps, key)
        yield from _places(one, (*steps, key))


def _change(document: Any, steps: Steps, chance: random.Random) -> None:
    parent = document
    for step in steps[:-1]:
        parent = parent[step]
    key = steps[-1]
    match chance.randrange(6):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[str(key) + "x"] = parent.pop(key)
        case 2 if isinstance(parent, list):
            parent.insert(key, copy.deepcopy(parent[key]))
        case 3:
            parent[key] = [parent[key]]
        case _:
            parent[key] = copy.deepcopy(chance.choice(_ODD))
