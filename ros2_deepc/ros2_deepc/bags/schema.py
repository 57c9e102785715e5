# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0
"""Message definitions as text, so that a bag explains itself to whoever reads it."""

import json
import os
import re
import sys
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

from .errors import BagError

NUMBERS = {  # name: struct code; char is an octet in ROS 2
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
PRIMITIVES = frozenset([*NUMBERS, "string", "wstring"])
SEPARATOR = "=" * 80
_FIELD_TYPE = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]\w*")


def message_definition(name: str, search: Sequence[Path] | None = None) -> str:
    """Text of a message type and of all types it is made of, concatenated as rosbag2 does (MCAP encoding ``ros2msg``).

    Args:
        name: full type name, e.g. ``deepc_msgs/msg/Sample``.
        search: folders that hold ``<package>/msg/<Type>.msg``, first hit wins; default: ``share`` of this Python's
            prefix, where the ROS wheels and this package install their messages, and of AMENT_PREFIX_PATH.

    Returns:
        The .msg file as it is, then, each once and depth first in sorted order, a line of 80 "=", a line
        "MSG: package/Type" and the file of each dependency.

    Raises:
        BagError: if a type's file is in none of the folders.
    """
    return _concatenated(_short(name), tuple(_installed() if search is None else search))


@lru_cache(maxsize=256)
def _concatenated(root: str, folders: tuple[Path, ...]) -> str:
    parts = [_text(root, folders)]
    _append_dependencies(root, parts[0], folders, {root}, parts)
    return "\n".join(parts)


def _installed() -> list[Path]:
    prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    return [Path(prefix) / "share" for prefix in dict.fromkeys(filter(None, prefixes))]


def _append_dependencies(name: str, text: str, folders: tuple[Path, ...], seen: set[str], parts: list[str]) -> None:
    for dependency in sorted(set(dependencies(text, name.split("/")[0]))):
        if dependency not in seen:
            seen.add(dependency)
            definition = _text(dependency, folders)
            parts.append(f"{SEPARATOR}\nMSG: {dependency}\n{definition}")
            _append_dependencies(dependency, definition, folders, seen, parts)


def dependencies(text: str, package: str) -> Iterator[str]:
    """Yields the non-primitive types (``package/Type``) that the fields of one .msg text name."""
    for line in text.splitlines():
        match = _FIELD_TYPE.match(line.partition("#")[0])
        if match and match[1] not in PRIMITIVES:
            yield _short(match[1] if "/" in match[1] else f"{package}/{match[1]}")


def _short(name: str) -> str:
    package, *_, kind = name.split("/")
    return f"{package}/{kind}"


def type_hash(name: str, search: Sequence[Path] | None = None) -> str:
    """The RIHS01 hash (REP 2011) of an installed message type, as its package states it; "" if it does not."""
    package, *_, kind = name.split("/")
    for folder in _installed() if search is None else search:
        path = folder / package / "msg" / f"{kind}.json"
        if path.is_file():
            hashes = json.loads(path.read_text(encoding="utf-8"))["type_hashes"]
            return next((h["hash_string"] for h in hashes if h["type_name"] == f"{package}/msg/{kind}"), "")
    return ""


def _text(name: str, folders: tuple[Path, ...]) -> str:
    package, kind = name.split("/")
    for folder in folders:
        path = folder / package / "msg" / f"{kind}.msg"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise BagError(f"no definition of {package}/msg/{kind} under {', '.join(map(str, folders))}: install {package}")
