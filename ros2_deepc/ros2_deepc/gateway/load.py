# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""From a YAML file to a tag map that can work."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from . import modbus_codec as codec
from .located import Section, Value, parse, read
from .places import at_of, base_of, clash, link_of, nth, serve_of, words
from .tags import BEAT, ECHO, PEER, SCAN, At, ModbusAt, PlantFacts, ReadTag, Supervision, TagMap, WriteTag

_SECTIONS = ("plant", "link", "sampling", "supervision", "fallback", "heartbeat", "round_trip", "defaults", "serve")
_MOST = 100_000  # tags of one entry
_COUNTERS = {"int16": 2**15, "uint16": 2**16, "int32": 2**31, "uint32": 2**32}


def load(path: Path) -> TagMap:
    """The tag map in a YAML file.

    Raises:
        GatewayError: with file, line and column of the first thing that cannot work.
    """
    return build(read(path))


def loads(text: str, file: str = "tags.yaml") -> TagMap:
    """The tag map in a YAML text; see `load`."""
    return build(parse(text, file))


def build(top: Section) -> TagMap:
    """The tag map of a parsed file; see `load`."""
    plant = _plant(top.need("plant").section())
    kind, link = link_of(top.need("link").section())
    part = {name: _optional(top, name) for name in _SECTIONS[2:]}
    base = base_of(kind, part["defaults"]) if part["defaults"] else None
    by, speed, poll, scan = _sampling(part["sampling"], plant, kind, base)
    supervision = _supervision(part, plant.sample_time / speed)
    outputs = _outputs(
        top.need("outputs", "what the field measures"), kind, base, supervision, plant.sample_time / speed
    )
    inputs, places = _inputs(top.need("inputs", "what may be written"), kind, base)
    counters, beat, modulus = _heartbeat(part["heartbeat"], kind, base)
    if scan is not None:
        counters, modulus = (scan[0], *counters), {SCAN: scan[1], **modulus}
    supervision = _ramp_fits(part["fallback"], inputs, supervision)
    written = list(zip(inputs, places, strict=True))
    if beat is not None and part["heartbeat"] is not None:
        written.append((beat, part["heartbeat"].place("write")))
    _one_writer(written)
    serve = serve_of(part["serve"]) if part["serve"] else None
    top.done()
    return TagMap(
        file=top.value.file, plant=plant, kind=kind, link=link, by=by, speed=speed, poll=poll,
        supervision=supervision, outputs=outputs, inputs=inputs, counters=counters, beat=beat, modulus=modulus,
        serve=serve, places=_positions(top),
    )  # fmt: skip


def _positions(top: Section) -> dict[str, tuple[int, int]]:
    """Line and column of every entry of outputs and inputs; those of an entry with a count share one."""
    found: dict[str, tuple[int, int]] = {}
    for kind in ("outputs", "inputs"):
        i = 0
        for item in top.need(kind).items():
            for _ in range(item.section().whole("count", 1)):
                found[f"{kind}.{i}"] = item.position
                i += 1
    return found


def _optional(top: Section, name: str) -> Section | None:
    found = top.get(name)
    return None if found is None else found.section()


def _plant(section: Section) -> PlantFacts:
    prior: dict[str, int] = {}
    options: dict[str, str] = {}
    if (value := section.get("prior")) is not None:
        inner = value.section()
        prior = {name: inner.whole(name, 0, 0, 10**6) for name in ("n", "q", "r", "s")}
        inner.done()
    if (value := section.get("options")) is not None:
        inner = value.section()
        options = {name: inner.need(name).text() for name in inner.keys()}  # noqa: SIM118 - not a dictionary
    facts = PlantFacts(
        name=section.need("name").text(),
        variant=section.text("variant", ""),
        sample_time=section.need("sample_time", "Ts in seconds").number(above=0.0),
        prior=prior,
        registered=section.text("registered", ""),
        options=options,
    )
    section.done()
    return facts


def _sampling(
    section: Section | None, plant: PlantFacts, kind: str, base: At | None
) -> tuple[str, float, float, tuple[ReadTag, int] | None]:
    """Who sets the pace: (by, speed, poll, scan counter with its modulus)."""
    if section is None:
        return "timer", 1.0, plant.sample_time, None
    by = section.text("by", "timer", ("timer", "scan"))
    speed = section.number("speed", 1.0, 1e-6, 1e9)
    period = plant.sample_time / speed
    poll = section.number("poll", period / 10, above=0.0)
    if poll > period / 2:
        section.place("poll").fail(f"{poll:g} s is too seldom to see every scan: at most {period / 2:g} s")
    scan = None
    if by == "scan":
        value = section.need("counter", "the counter that the field increments every scan")
        scan = _counter(SCAN, value, kind, base)
    section.done()
    return by, speed, poll, scan


def _counter(role: str, value: Value, kind: str, base: At | None) -> tuple[ReadTag, int]:
    """A counter of the field and the count at which it starts again."""
    section = value.section()
    modulus = section.whole("modulus", 0, 2, 2**32)
    at = at_of(kind, section, base)
    return ReadTag(name=role, at=at), modulus or _modulus(at, value)


def _modulus(at: At, value: Value) -> int:
    if not isinstance(at, ModbusAt):
        return 2**32
    if at.type not in _COUNTERS:
        value.fail(f"a counter is a whole number, not {at.type}: give type: uint16")
    return _COUNTERS[at.type]


def _supervision(part: dict[str, Section | None], period: float) -> Supervision:
    found = Supervision(stale_after=3.5 * period, fallback_after=10 * period)
    if (section := part["supervision"]) is not None:
        stale = section.number("stale_after", found.stale_after, above=0.0)
        if stale < 2 * period:
            section.place("stale_after").fail(f"{stale:g} s is below two periods: at least {2 * period:g} s")
        found = replace(
            found,
            stale_after=stale,
            fallback_after=section.number("fallback_after", max(found.fallback_after, stale), above=0.0),
            good_samples=section.whole("good_samples", 3, 1, 100_000),
            clock_tolerance=section.number("clock_tolerance", 1.0, above=0.0),
        )
        if found.fallback_after < stale:
            section.place("fallback_after").fail(f"{found.fallback_after:g} s is below stale_after = {stale:g} s")
        section.done()
    if (section := part["fallback"]) is not None:
        found = replace(
            found,
            policy=section.text("policy", "ramp", ("hold", "ramp", "release")),
            ramp=section.number("seconds", 2.0, 0.0),
        )
        section.done()
    if (section := part["round_trip"]) is not None:
        found = replace(found, round_trip_file=section.need("file").text())
        section.done()
    return found


def _outputs(value: Value, kind: str, base: At | None, supervision: Supervision, period: float) -> tuple[ReadTag, ...]:
    found: list[ReadTag] = []
    places: dict[str, Value] = {}
    for item in _some(value):
        section = item.section()
        name, count = _name(section), section.whole("count", 1, 1, _MOST)
        unit, raw_unit, scale, offset = _scaling(section)
        low, high = _pair(section, "range", (-np.inf, np.inf))
        stale = section.number("stale_after", supervision.stale_after, above=0.0)
        if stale < 2 * period:
            section.place("stale_after").fail(f"{stale:g} s is below two periods: at least {2 * period:g} s")
        frozen = section.number("frozen_after", np.inf, above=0.0)
        at = at_of(kind, section.need("at", "where the tag is").section(), base)
        section.done()
        for i in range(count):
            tag = ReadTag(
                name=f"{name}{i}" if count > 1 else name, at=nth(at, i) if count > 1 else at, unit=unit,
                raw_unit=raw_unit, scale=scale, offset=offset, low=low, high=high, stale_after=stale,
                frozen_after=frozen,
            )  # fmt: skip
            _new_name(tag.name, places, section.place("name"))
            found.append(tag)
        _registers_exist(found[-1].at, section.place("at"))
    return tuple(found)


def _inputs(value: Value, kind: str, base: At | None) -> tuple[tuple[WriteTag, ...], list[Value]]:
    found: list[WriteTag] = []
    places: list[Value] = []
    names: dict[str, Value] = {}
    for item in _some(value):
        section = item.section()
        name, count = _name(section), section.whole("count", 1, 1, _MOST)
        unit, raw_unit, scale, offset = _scaling(section)
        section.need("limits", "a tag that is written needs limits: [low, high]")
        low, high = _pair(section, "limits", (0.0, 0.0))
        rate = section.need("max_rate", "the largest change per second of a tag that is written").number(above=0.0)
        safe = section.need("safe", "the value to fall back to").number()
        if not low <= safe <= high:
            section.place("safe").fail(f"{safe:g} is outside the limits {low:g} to {high:g}")
        clamp = section.text("on_violation", "refuse", ("refuse", "clamp")) == "clamp"
        permit_value = section.get("permit")
        permit = ("controller",) if permit_value is None else tuple(v.text() for v in permit_value.items())
        at = at_of(kind, section.need("at", "where the tag is").section(), base)
        section.done()
        for i in range(count):
            tag = WriteTag(
                name=f"{name}{i}" if count > 1 else name, at=nth(at, i) if count > 1 else at, unit=unit,
                raw_unit=raw_unit, scale=scale, offset=offset, low=low, high=high, max_rate=rate, safe=safe,
                clamp=clamp, permit=permit,
            )  # fmt: skip
            _new_name(tag.name, names, section.place("name"))
            found.append(tag)
            places.append(section.place("at"))
        _registers_exist(found[-1].at, section.place("at"))
        _writable(found[-1], section)
    return tuple(found), places


def _some(value: Value) -> list[Value]:
    items = value.items()
    if not items:
        value.fail("at least one tag is needed")
    return items


def _name(section: Section) -> str:
    name = section.need("name").text()
    if not name or not name.isprintable() or len(name) > 100:
        section.place("name").fail(f"{name!r} is not a name")
    return name


def _new_name(name: str, seen: dict[str, Value], place: Value) -> None:
    if name in seen:
        place.fail(f"the name {name!r} is taken")
    seen[name] = place


def _scaling(section: Section) -> tuple[str, str, float, float]:
    """(unit, raw unit, scale, offset), which must not contradict each other."""
    unit = section.need("unit", "give '' for a pure number").text()
    raw_unit = section.text("raw_unit", unit)
    scale, offset = section.number("scale", 1.0), section.number("offset", 0.0)
    if scale == 0.0:
        section.place("scale").fail("0 would lose the value")
    if raw_unit != unit and section.get("scale") is None:
        section.place("raw_unit").fail(f"{raw_unit} to {unit} needs a scale: {unit} per {raw_unit}")
    return unit, raw_unit, scale, offset


def _pair(section: Section, key: str, default: tuple[float, float]) -> tuple[float, float]:
    value = section.get(key)
    if value is None:
        return default
    low, high = value.numbers(2)
    if low >= high:
        value.fail(f"{low:g} should be below {high:g}")
    return low, high


def _registers_exist(at: At, place: Value) -> None:
    if isinstance(at, ModbusAt) and at.address + codec.size(at.type) > 0x10000:
        place.fail(f"the last tag of this entry, at {at.address}, ends behind register 65535")


def _writable(tag: WriteTag, section: Section) -> None:
    """Limits must survive the trip through the field's own type."""
    if not isinstance(tag.at, ModbusAt):
        return
    if tag.at.table == "input":
        section.place("at").fail("input registers cannot be written: use table: holding")
    low, high = codec.bounds(tag.at.type)
    for limit in (tag.low, tag.high, tag.safe):
        raw = (limit - tag.offset) / tag.scale
        if not low <= raw <= high:
            section.place("limits").fail(f"{limit:g} {tag.unit} is {raw:g} raw, which {tag.at.type} cannot hold")


def _heartbeat(
    section: Section | None, kind: str, base: At | None
) -> tuple[tuple[ReadTag, ...], WriteTag | None, dict[str, int]]:
    """Counters to read, the counter to write, and where each starts again."""
    counters: list[ReadTag] = []
    modulus: dict[str, int] = {}
    beat = None
    if section is None:
        return (), None, {}
    for role in (PEER, ECHO):
        if (value := section.get({PEER: "read", ECHO: "echo"}[role])) is not None:
            tag, modulus[role] = _counter(role, value, kind, base)
            counters.append(tag)
    if (value := section.get("write")) is not None:
        tag, modulus[BEAT] = _counter(BEAT, value, kind, base)
        if isinstance(tag.at, ModbusAt) and tag.at.table == "input":
            value.fail("input registers cannot be written: use table: holding")
        beat = WriteTag(name=BEAT, at=tag.at, low=0.0, high=float(modulus[BEAT] - 1))
    if ECHO in modulus and beat is None:
        section.place("echo").fail("nothing is written that could come back: give write as well")
    if ECHO in modulus and modulus[ECHO] < modulus[BEAT]:
        section.place("echo").fail("must be able to hold every value of write")
    section.done()
    return tuple(counters), beat, modulus


def _ramp_fits(section: Section | None, inputs: tuple[WriteTag, ...], supervision: Supervision) -> Supervision:
    """The ramp to the safe values must not be faster than the tags allow; if none was asked for, it is made so."""
    need, name = max((max(t.high - t.safe, t.safe - t.low) / t.max_rate, t.name) for t in inputs)
    if need <= supervision.ramp or supervision.policy != "ramp":
        return supervision
    if section is not None and section.get("seconds") is not None:
        section.place("seconds").fail(f"the ramp of {name} would break its max_rate: give {need:.6g} s or more")
    return replace(supervision, ramp=need)


def _one_writer(tags: list[tuple[WriteTag, Value]]) -> None:
    """No two tags may write the same place."""
    buckets: dict[object, list[tuple[WriteTag, Value]]] = {}
    for tag, place in tags:
        for key in _touched(tag.at):
            for other, _ in buckets.get(key, ()):
                if clash(tag.at, other.at):
                    place.fail(f"{tag.name} and {other.name} both write {words(tag.at)}")
            buckets.setdefault(key, []).append((tag, place))


def _touched(at: At) -> list[object]:
    """Keys under which tags that might clash meet."""
    if isinstance(at, ModbusAt):
        return [(at.table, at.unit_id, at.address + i) for i in range(codec.size(at.type))]
    return [getattr(at, "node", None) or words(at)]
