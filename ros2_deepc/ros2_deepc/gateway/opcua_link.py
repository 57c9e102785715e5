# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""OPC UA: the gateway as a client."""

import asyncio
import logging
import os
from collections.abc import Awaitable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua.uaerrors import UaError

from .assemble import Quality, Scan
from .errors import GatewayError, LinkError
from .opcua_pki import Pki
from .tags import Array, OpcuaAt, TagMap

T = TypeVar("T")

URI = "urn:ros2_deepc:gateway"
_EPOCH = datetime(1970, 1, 1)
_NULL_YEAR = 1601  # DateTime 0: there is no time
_LATEST = 2**63 - 1  # [ns since 1970], in the year 2262
_BAD, _UNCERTAIN = 0x80000000, 0x40000000

logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # every failure is reported by the gateway itself


class OpcuaLink:
    """Reads all tags with one Read request, writes with one Write request.

    Sign and encrypt with Basic256Sha256 unless the tag map says otherwise for the loopback; the server's certificate
    must be in trusted/ before anything, a password least of all, is sent to it.

    Args:
        tags: with places of kind OpcuaAt.

    Raises:
        GatewayError: if the password is missing, or elements of an array to write are.
    """

    atomic = False  # one request, but nothing says that the server answers it in one piece

    def __init__(self, tags: TagMap) -> None:
        self._link = tags.link
        reads = [at for tag in tags.reads if isinstance(at := tag.at, OpcuaAt)]
        self._read_ids = list(dict.fromkeys(at.node for at in reads))
        place = {node: i for i, node in enumerate(self._read_ids)}
        self._places = [(place[at.node], at.index) for at in reads]
        self._writes = _grouped([at for tag in tags.writes if isinstance(at := tag.at, OpcuaAt)], tags.file)
        self._pki = None if self._link.insecure else Pki(Path(tags.file).parent / self._link.pki, URI)
        self._password = os.environ.get(self._link.password_env, "") if self._link.user else ""
        if self._link.user and not self._password:
            raise GatewayError(f"{tags.file}: the environment variable {self._link.password_env} is not set")
        self._client: Client | None = None
        self._params = ua.ReadParameters()
        self._nodes: dict[str, ua.NodeId] = {}

    async def connect(self) -> None:
        """Connects and looks whether every node exists."""
        await self.close()
        client = Client(self._link.url, timeout=self._link.timeout)
        client.application_uri = URI
        try:
            await self._secure(client)
            if self._link.user:
                client.set_user(self._link.user)
                client.set_password(self._password)
            await self._tried(client.connect(), several=5)
        except LinkError:
            await _drop(client)
            raise
        self._client = client
        await self._resolve(client)

    async def read(self) -> Scan:
        """Reads every node once."""
        answers = await self._values(self._connected())
        n = len(self._places)
        raw, quality = np.full(n, np.nan), np.full(n, Quality.BAD, dtype=np.uint8)
        source = np.zeros(n, dtype=np.int64)
        for i, (node, index) in enumerate(self._places):
            raw[i], quality[i], source[i] = take(answers[node], index)
        return Scan(raw=raw, quality=quality, source_ns=source)

    async def write(self, raw: Array) -> None:
        """Writes every node that has a number for each of its elements."""
        values = []
        for node, kind, places, scalar in self._writes:
            numbers = raw[places]
            if np.isnan(numbers).any():
                continue
            typed = [float(x) if kind.name in ("Double", "Float") else round(float(x)) for x in numbers]
            value = ua.DataValue(ua.Variant(typed[0] if scalar else typed, kind))
            values.append(ua.WriteValue(self._nodes[node], ua.AttributeIds.Value, Value=value))
        if not values:
            return
        results = await self._tried(self._connected().uaclient.write(ua.WriteParameters(NodesToWrite=values)))
        if not isinstance(results, list) or len(results) != len(values):
            raise LinkError(f"{self._link.url}: not one answer for each of {len(values)} nodes to write")
        for value, status in zip(values, results, strict=True):
            if not (isinstance(status, ua.StatusCode) and status.is_good()):
                raise LinkError(f"{self._link.url}: writing {value.NodeId.to_string()}: {getattr(status, 'name', '?')}")

    async def close(self) -> None:
        """Disconnects."""
        client, self._client = self._client, None
        if client is not None:
            await _drop(client)

    async def _secure(self, client: Client) -> None:
        if self._pki is None:
            return
        endpoints = await self._tried(client.connect_and_get_server_endpoints())
        wanted = SecurityPolicyBasic256Sha256
        try:
            found = Client.find_endpoint(endpoints, ua.MessageSecurityMode.SignAndEncrypt, wanted.URI)
        except UaError:
            raise LinkError(f"{self._link.url}: offers no Basic256Sha256 with sign and encrypt") from None
        der = found.ServerCertificate
        if not der or not self._pki.trusts(der):
            raise LinkError(
                f"{self._link.url}: its certificate is not trusted; look at it in {self._pki.folder}/rejected, then "
                "move it to trusted"
            )
        own, key = str(self._pki.certificate), str(self._pki.key)
        await self._tried(client.set_security(wanted, own, key, server_certificate=der))

    async def _resolve(self, client: Client) -> None:
        """Node ids with namespaces by number, and whether they exist."""
        namespaces = await self._tried(client.get_namespace_array())
        for text in (*self._read_ids, *(node for node, *_ in self._writes)):
            self._nodes[text] = self._node_id(namespaces, text)
        self._params = ua.ReadParameters(
            TimestampsToReturn=ua.TimestampsToReturn.Source,
            NodesToRead=[ua.ReadValueId(self._nodes[text], ua.AttributeIds.Value) for text in self._read_ids],
        )
        for text, answer in zip(self._read_ids, await self._values(client), strict=True):
            status = getattr(answer, "StatusCode", None)
            if status is not None and status.value == ua.StatusCodes.BadNodeIdUnknown:
                raise LinkError(f"{self._link.url}: there is no node {text}")

    async def _values(self, client: Client) -> list[Any]:
        """One answer for every node to read."""
        answers = await self._tried(client.uaclient.read(self._params))
        if not isinstance(answers, list) or len(answers) != len(self._read_ids):
            raise LinkError(f"{self._link.url}: not one value for each of {len(self._read_ids)} nodes")
        return answers

    def _node_id(self, namespaces: Any, text: str) -> ua.NodeId:
        if text.startswith("nsu="):
            uri, _, rest = text[4:].partition(";")
            if not isinstance(namespaces, list) or uri not in namespaces:
                raise LinkError(f"{self._link.url}: there is no namespace {uri}; {namespaces}")
            text = f"ns={namespaces.index(uri)};{rest}"
        try:
            return ua.NodeId.from_string(text)
        except UaError as error:
            raise LinkError(f"{self._link.url}: {text} is not a node id: {error}") from None

    def _connected(self) -> Client:
        if self._client is None:
            raise LinkError(f"{self._link.url}: not connected")
        return self._client

    async def _tried(self, request: Awaitable[T], several: int = 1) -> T:
        """A request whose every failure is a LinkError: nothing that a server sends may end the gateway."""
        try:
            async with asyncio.timeout(several * self._link.timeout):
                return await request
        except TimeoutError:
            raise LinkError(f"{self._link.url}: no answer within {several * self._link.timeout:g} s") from None
        except Exception as error:
            raise LinkError(f"{self._link.url}: {_words(error)}") from None


def _grouped(places: list[OpcuaAt], file: str) -> list[tuple[str, ua.VariantType, list[int], bool]]:
    """For every node to write: its type, which tags are its elements in order, and whether it is a scalar."""
    nodes: dict[str, list[tuple[int, int]]] = {}
    kinds = {at.node: ua.VariantType[at.type] for at in places}
    for i, at in enumerate(places):
        nodes.setdefault(at.node, []).append((at.index, i))
    found = []
    for node, elements in nodes.items():
        elements.sort()
        scalar = elements[0][0] == -1
        if not scalar and [index for index, _ in elements] != list(range(len(elements))):
            raise GatewayError(f"{file}: an array is written whole: {node} needs all elements from 0 on")
        found.append((node, kinds[node], [i for _, i in elements], scalar))
    return found


def take(answer: Any, index: int) -> tuple[float, Quality, int]:
    """What a server says of a value: number, quality, source time [ns since 1970].

    Args:
        answer: a DataValue, or whatever came instead of one.
        index: element of an array, or -1 for a scalar.

    Returns:
        NaN for what is not a number; time 0 if there is none. Never fails.
    """
    if not isinstance(answer, ua.DataValue):
        return np.nan, Quality.BAD, 0
    value: Any = getattr(answer.Value, "Value", None)
    if index >= 0:
        value = value[index] if isinstance(value, list) and index < len(value) else None
    raw = float(value) if isinstance(value, (bool, int, float)) else np.nan
    return raw, _quality(answer.StatusCode), _time_ns(answer.SourceTimestamp)


def _quality(status: Any) -> Quality:
    code = getattr(status, "value", 0)
    if not isinstance(code, int) or code & _BAD:
        return Quality.BAD
    return Quality.UNCERTAIN if code & _UNCERTAIN else Quality.GOOD


def _time_ns(time: Any) -> int:
    if not isinstance(time, datetime):
        return 0
    if time.year <= _NULL_YEAR:
        return 0
    since: timedelta = time.replace(tzinfo=None) - _EPOCH
    ns = (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
    return min(max(ns, -_LATEST), _LATEST)  # a clock that is so wrong stands still for us: its tags become STALE


def _words(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}: {text[0]}" if text else type(error).__name__


async def _drop(client: Client) -> None:
    """Disconnects, whatever state the connection is in."""
    try:
        async with asyncio.timeout(1.0):
            await client.disconnect()
    except Exception as error:  # the other side may be gone
        logging.getLogger(__name__).debug("disconnecting: %s", error)
    finally:
        client.disconnect_socket()
        await asyncio.sleep(0)  # the loop closes the socket
