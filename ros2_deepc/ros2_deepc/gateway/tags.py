# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""The tag map: what the field calls things, where they are, and what may be done to them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SCAN, PEER, ECHO, BEAT = "scan", "peer", "echo", "beat"  # names of the counters beside outputs and inputs


@dataclass(frozen=True, slots=True, kw_only=True)
class ModbusAt:
    """Where a tag is in a Modbus device.

    Attributes:
        table: "holding" or "input" registers.
        address: first register, from 0.
        type: see `modbus_codec.TYPES`.
        words: order of bytes as the device sends them, e.g. ABCD or CDAB.
        unit_id: which device behind the address.
    """

    table: str
    address: int
    type: str
    words: str
    unit_id: int


@dataclass(frozen=True, slots=True, kw_only=True)
class OpcuaAt:
    """Where a tag is in an OPC UA server.

    Attributes:
        node: node id, e.g. ``ns=2;s=y1`` or ``nsu=urn:plant;s=y1``.
        index: element of an array node, or -1 for a scalar.
        type: OPC UA type written.
    """

    node: str
    index: int
    type: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RosAt:
    """Where a tag is on ROS topics.

    Attributes:
        topic: name.
        type: message type, e.g. ``std_msgs/msg/Float64MultiArray``.
        field: path of the number, e.g. ``data[2]`` or ``twist.linear.x``.
        stamp: path of the source time, or empty.
    """

    topic: str
    type: str
    field: str
    stamp: str


At = ModbusAt | OpcuaAt | RosAt


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadTag:
    """A number that comes from the field; value = scale * raw + offset.

    Attributes:
        name: in the vector of outputs; for counters their role.
        at: where it is.
        unit: of the value.
        raw_unit: of the raw number.
        scale: value per raw.
        offset: value at raw 0.
        low: below this the value is BAD.
        high: above this the value is BAD.
        stale_after: [s] without a new source time after which it is STALE.
        frozen_after: [s] without any change of the value after which it is UNCERTAIN; inf = may stand still.
    """

    name: str
    at: At
    unit: str = ""
    raw_unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    stale_after: float = np.inf
    frozen_after: float = np.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class WriteTag:
    """A number that goes to the field; raw = (value - offset) / scale.

    Attributes:
        name: in the vector of inputs; for counters their role.
        at: where it is.
        unit: of the value.
        raw_unit: of the raw number.
        scale: value per raw.
        offset: value at raw 0.
        low: smallest value ever written.
        high: largest value ever written.
        max_rate: largest change [unit/s].
        safe: value to fall back to.
        clamp: bring values out of range or over rate to the nearest allowed one instead of refusing the vector.
        permit: whose commands may be written.
    """

    name: str
    at: At
    unit: str = ""
    raw_unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    max_rate: float = np.inf
    safe: float = 0.0
    clamp: bool = False
    permit: tuple[str, ...] = ("controller",)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantFacts:
    """What the gateway says of the plant on behalf of the field.

    Attributes:
        name: of the plant.
        variant: of the plant, or empty.
        sample_time: Ts [s].
        prior: n, q, r, s; 0 = not known.
        registered: name of a registered plant whose names and units the tags must have, or empty.
        options: of that plant.
    """

    name: str
    variant: str = ""
    sample_time: float
    prior: Mapping[str, int] = field(default_factory=dict)
    registered: str = ""
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def s(self) -> int:
        """Nilpotency index assumed, at least 1."""
        return max(int(self.prior.get("s", 0)), 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Supervision:
    """When to trust the field and what to do when not.

    Attributes:
        stale_after: [s] without news of a tag, without the field's counter, or without commands until DEGRADED.
        fallback_after: [s] in DEGRADED until FALLBACK.
        good_samples: good samples in a row before RUN.
        clock_tolerance: [s] between source times and the own clock before source times are ignored.
        policy: hold, ramp or release.
        ramp: [s] from the last to the safe values.
        round_trip_file: where the round trip of the data is kept between sessions; empty = this session only.
    """

    stale_after: float
    fallback_after: float
    good_samples: int = 3
    clock_tolerance: float = 1.0
    policy: str = "ramp"
    ramp: float = 2.0
    round_trip_file: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Serve:
    """A read-only server for whoever wants to look.

    Attributes:
        kind: "opcua" or "modbus".
        host: Modbus: address to listen on.
        port: Modbus: TCP port.
        url: OPC UA: where it listens; so are all that follow.
        insecure: no encryption and no users, on the loopback only.
        pki: folder of certificates.
        user: who may read.
        password_env: environment variable with the password.
    """

    kind: str
    host: str = "127.0.0.1"
    port: int = 0
    url: str = ""
    insecure: bool = False
    pki: str = ""
    user: str = ""
    password_env: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TagMap:
    """A field device and the zone it serves.

    Attributes:
        file: where it was read from.
        plant: what to say of the plant.
        kind: "modbus", "opcua" or "ros".
        link: settings of the link, as the protocol's module checks them.
        by: "timer" (own clock) or "scan" (a counter of the field, in ``counters``).
        speed: how many times faster than ``plant.sample_time`` samples really come (simulated plants only).
        poll: [s] between two looks at the scan counter.
        supervision: when to trust the field.
        outputs: in the order of the vector.
        inputs: in the order of the vector.
        counters: the counters SCAN, PEER and ECHO, those that there are, in this order.
        beat: the counter that the gateway writes, or None.
        modulus: count at which each counter starts again from 0, by role.
        serve: the server for whoever wants to look, or None.
        places: line and column of each entry, e.g. of ``outputs.0``.
    """

    file: str
    plant: PlantFacts
    kind: str
    link: Any
    by: str
    speed: float
    poll: float
    supervision: Supervision
    outputs: tuple[ReadTag, ...]
    inputs: tuple[WriteTag, ...]
    counters: tuple[ReadTag, ...]
    beat: WriteTag | None
    modulus: Mapping[str, int]
    serve: Serve | None = None
    places: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def period(self) -> float:
        """Real time between two samples [s]."""
        return self.plant.sample_time / self.speed

    @property
    def reads(self) -> tuple[ReadTag, ...]:
        """Everything to read: outputs, then counters."""
        return self.outputs + self.counters

    @property
    def writes(self) -> tuple[WriteTag, ...]:
        """Everything that may be written: inputs, then the heartbeat."""
        return self.inputs + ((self.beat,) if self.beat else ())
