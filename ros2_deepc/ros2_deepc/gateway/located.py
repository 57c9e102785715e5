# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""YAML whose every value knows where it stands, so that an error can point at it."""

import difflib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from .errors import GatewayError

_LARGEST_FILE = 4_000_000  # [bytes]
_STR = "tag:yaml.org,2002:str"


class Value:
    """One value of a YAML file.

    Args:
        node: as parsed.
        file: name of the file, for errors.
        path: how a reader would call it, e.g. ``outputs[0].scale``.
    """

    def __init__(self, node: Node, file: str, path: str) -> None:
        self.node, self.file, self.path = node, file, path

    def fail(self, problem: str) -> NoReturn:
        """Raises a GatewayError with file, line, column and path."""
        line, column = self.position
        name = f"{self.path}: " if self.path else ""
        raise GatewayError(f"{self.file}, line {line}, column {column}: {name}{problem}")

    @property
    def position(self) -> tuple[int, int]:
        """Line and column, from 1."""
        return self.node.start_mark.line + 1, self.node.start_mark.column + 1

    def text(self, choices: Sequence[str] = ()) -> str:
        """A string; one of ``choices`` if there are any."""
        if not isinstance(self.node, ScalarNode):
            self.fail("expected a text")
        text = str(self.node.value)
        if choices and text not in choices:
            near = difflib.get_close_matches(text, choices, n=1)
            self.fail(f"{text!r} is not one of {', '.join(choices)}" + (f"; did you mean {near[0]}?" if near else ""))
        return text

    def number(self, low: float = -math.inf, high: float = math.inf, *, above: float = -math.inf) -> float:
        """A finite number with low <= number <= high and above < number."""
        text = self._scalar("a number")
        try:
            number = float(text)
        except ValueError:
            self.fail(f"expected a number, found {text!r}")
        if not math.isfinite(number):
            self.fail(f"{text} is not a finite number")
        if not (low <= number <= high and number > above):
            bound = f"above {above:g}" if above > -math.inf else f"at least {low:g}"
            self.fail(f"{text} is out of range: {bound}" + (f", at most {high:g}" if high < math.inf else ""))
        return number

    def whole(self, low: int = 0, high: int = 2**53) -> int:
        """A whole number with low <= number <= high."""
        text = self._scalar("a whole number")
        try:
            number = int(text, 0)
        except ValueError:
            self.fail(f"expected a whole number, found {text!r}")
        if not low <= number <= high:
            self.fail(f"{text} is out of range {low} to {high}")
        return number

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self.node, ScalarNode) or self.node.value not in ("true", "false"):
            self.fail("expected true or false")
        return bool(self.node.value == "true")

    def items(self) -> "list[Value]":
        """The entries of a list."""
        if not isinstance(self.node, SequenceNode):
            self.fail("expected a list")
        return [Value(node, self.file, f"{self.path}[{i}]") for i, node in enumerate(self.node.value)]

    def numbers(self, count: int) -> tuple[float, ...]:
        """A list of so many finite numbers."""
        items = self.items()
        if len(items) != count:
            self.fail(f"expected {count} numbers, found {len(items)}")
        return tuple(item.number() for item in items)

    def section(self) -> "Section":
        """A mapping."""
        return Section(self)

    def _scalar(self, kind: str) -> str:
        if not isinstance(self.node, ScalarNode) or (self.node.tag == _STR and self.node.style):
            self.fail(f"expected {kind}")
        return str(self.node.value)


class Section:
    """A mapping of a YAML file whose keys must all be asked for before ``done``.

    Attributes:
        value: where it stands.

    Raises:
        GatewayError: if the value is not a mapping, or has a key twice or one that is not a text.
    """

    def __init__(self, value: Value) -> None:
        node, file = value.node, value.file
        if not isinstance(node, MappingNode):
            value.fail("expected a section with KEY: VALUE lines")
        self.value = value
        self._values: dict[str, Value] = {}
        self._keys: dict[str, Value] = {}
        self._asked: list[str] = []
        for key_node, value_node in node.value:
            key = Value(key_node, file, value.path).text()
            place = Value(key_node, file, f"{value.path}.{key}".lstrip("."))
            if key in self._values:
                place.fail("is there twice")
            self._keys[key] = place
            self._values[key] = Value(value_node, file, place.path)

    def get(self, key: str) -> Value | None:
        """The value of a key, or None."""
        self._asked.append(key)
        return self._values.get(key)

    def need(self, key: str, why: str = "") -> Value:
        """The value of a key that must be there."""
        found = self.get(key)
        if found is None:
            self.value.fail(f"{key!r} is missing" + (f": {why}" if why else ""))
        return found

    def number(
        self, key: str, default: float, low: float = -math.inf, high: float = math.inf, *, above: float = -math.inf
    ) -> float:
        """A finite number under a key, or the default."""
        found = self.get(key)
        return default if found is None else found.number(low, high, above=above)

    def text(self, key: str, default: str, choices: Sequence[str] = ()) -> str:
        """A text under a key, or the default."""
        found = self.get(key)
        return default if found is None else found.text(choices)

    def whole(self, key: str, default: int, low: int = 0, high: int = 2**53) -> int:
        """A whole number under a key, or the default."""
        found = self.get(key)
        return default if found is None else found.whole(low, high)

    def flag(self, key: str, default: bool) -> bool:
        """True or false under a key, or the default."""
        found = self.get(key)
        return default if found is None else found.flag()

    def place(self, key: str) -> Value:
        """Where a key stands, for errors; the section itself if the key is not there."""
        return self._keys.get(key, self.value)

    def keys(self) -> list[str]:
        """All keys, in order."""
        return list(self._values)

    def done(self) -> None:
        """Fails for the first key that nobody asked for."""
        for key, place in self._keys.items():
            if key not in self._asked:
                near = difflib.get_close_matches(key, self._asked, n=1)
                known = f"did you mean {near[0]}?" if near else f"known here: {', '.join(dict.fromkeys(self._asked))}"
                place.fail(f"unknown key; {known}")


def parse(text: str, file: str) -> Section:
    """The top section of a YAML text.

    Raises:
        GatewayError: if it is not valid YAML, not one mapping, or too large or too deep to be a tag map.
    """
    if len(text) > _LARGEST_FILE:
        raise GatewayError(f"{file}: {len(text)} characters are too many for a tag map ({_LARGEST_FILE} at most)")
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise GatewayError(f"{file}{where}: not valid YAML: {problem}") from None
    except RecursionError:
        raise GatewayError(f"{file}: nested too deeply for a tag map") from None
    except ValueError as error:  # characters that YAML does not allow, numbers that do not exist
        raise GatewayError(f"{file}: not valid YAML: {error}") from None
    if node is None:
        raise GatewayError(f"{file}: is empty")
    return Section(Value(node, file, ""))


def read(path: Path) -> Section:
    """The top section of a YAML file.

    Raises:
        GatewayError: if it cannot be read, or see `parse`.
    """
    try:
        return parse(path.read_text(encoding="utf-8"), str(path))
    except OSError as error:
        raise GatewayError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise GatewayError(f"{path}: is not text in UTF-8") from None
