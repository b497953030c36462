"""Reader of JointState messages as printed by ``rostopic echo`` and ``ros2 topic echo``: one YAML document per message.

``measured_js`` has the arm's six joints, ``jaw/measured_js`` the jaw; one file may contain both. Older dVRK versions
(``state_joint_current``) prefix the names with ``outer_``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from dvrk_cmaes.errors import InputError
from dvrk_cmaes.io.short_text import shown
from dvrk_cmaes.io.yaml_file import yaml_documents
from dvrk_cmaes.joints.names import joints_by_count, joints_of_arm, notes_on_messages
from dvrk_cmaes.joints.rows import JointFile, JointRow, ReadAs
from dvrk_cmaes.joints.times import parse_stamp

EXPECTED = "joint readings (JointState messages)"

POSITION = re.compile(r"^position:", re.MULTILINE)
"""Beginning of a line that every text of printed JointState messages has."""


def read_joint_state(path: str, text: str, read_as: ReadAs) -> JointFile:
    """Read all messages of a file, as `file_of_messages`; arguments and errors as there.

    Parameters
    ----------
    path
        The file's path, for messages.
    text
        The file's content.
    read_as
        As of `file_of_messages`.
    """
    messages = []
    for count, message in enumerate(yaml_documents(path, text, expected=EXPECTED)):
        where = f"{path}: message {count + 1}"
        values, stated = message.get("position"), message.get("name") or []
        if not isinstance(values, list):
            raise InputError(f"{where}: position: expected a list of numbers, got {shown(values)}")
        if values and stated and (not isinstance(stated, list) or len(stated) != len(values)):
            raise InputError(
                f"{where}: name: expected {len(values)} different names, one for each position, got {shown(stated)}"
            )
        header = message.get("header")
        time = parse_stamp(f"{where}: header.stamp", header.get("stamp")) if isinstance(header, Mapping) else None
        messages.append((where, [str(name) for name in stated], values, time))
    return file_of_messages(path, "JointState messages (YAML)", messages, read_as)


Message = tuple[str, Sequence[str], Sequence[object], int | None]
"""A message: the beginning of error messages, the stated names, if any, the positions, and the time, ns."""


def file_of_messages(path: str, kind: str, messages: Sequence[Message], read_as: ReadAs) -> JointFile:
    """Return a file of messages, without those that have no positions, as before an arm is up.

    Two messages with different joints, as the arm's and the jaw's, are one row.

    Parameters
    ----------
    path, kind
        The file's path and the name of its format.
    messages
        The messages.
    read_as
        Names of the joints that are accepted, and the arm whose are read of messages with those of several.

    Raises
    ------
    InputError
        A message is not valid; the error names the file, the message, the field and what was expected.
    """
    rows: dict[str, JointRow] = {}
    for count, (where, stated, values, time) in enumerate(messages):
        if values:
            in_order = [] if stated else joints_by_count(f"{where}: position", len(values))
            places = joints_of_arm(f"{where}: name", stated or in_order, read_as.names, read_as.arm)
            rows[f"message {count + 1}"] = (where, {name: values[k] for name, k in places.items()}, time)
    skipped = len(messages) - len(rows)
    if not rows:
        raise InputError(f"{path}: expected {EXPECTED}, got {f'{skipped} without positions' if skipped else 'none'}")
    unnamed = any(values and not stated for _, stated, values, _ in messages)
    if len(rows) == 2:
        (where, first, time), (_, second, _) = rows.values()
        if not set(first) & set(second):
            rows = {"both": (where, {**first, **second}, time)}
    return JointFile.of(path, kind, rows, "message", notes_on_messages(unnamed=unnamed, skipped=skipped))
