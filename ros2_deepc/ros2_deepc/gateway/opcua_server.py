# SPDX-FileCopyrightText: 2026 The ros2_deepc authors
# SPDX-License-Identifier: Apache-2.0

"""OPC UA: servers with named users, an allow-list of nodes to write, and no way around encryption but the loopback."""

import asyncio
import hmac
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import USER_TYPES, PermissionRuleset, User, UserRole
from asyncua.ua.ua_binary import struct_from_binary
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from .errors import GatewayError
from .opcua_pki import Pki
from .places import is_loopback

_CLOSING = 0.02  # [s] for closed sockets to leave the event loop

logging.getLogger("asyncua").setLevel(logging.CRITICAL)


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Who may do what.

    Attributes:
        users: password of each user.
        writes: for each user, the names of the nodes that it may write; nobody else writes anything.
        pki: folder of certificates; None = no encryption and no users, on the loopback only.
    """

    users: Mapping[str, str] = field(default_factory=dict)
    writes: Mapping[str, Sequence[str]] = field(default_factory=dict)
    pki: Path | None = None


class _Users:
    """Names and passwords; compared in constant time."""

    def __init__(self, users: Mapping[str, str], counts: dict[str, int]) -> None:
        self._users, self._counts = users, counts

    def get_user(
        self,
        iserver: object,  # noqa: ARG002 - the server's signature
        username: str | None = None,
        password: Any = None,
        certificate: object = None,  # noqa: ARG002
    ) -> User | None:
        given = password if isinstance(password, bytes) else str(password or "").encode()
        known = self._users.get(username or "", "")
        if hmac.compare_digest(given, known.encode()) and known:
            return User(role=UserRole.User, name=username)
        self._counts["user"] += 1
        return None


class _Rules(PermissionRuleset):  # type: ignore[misc]
    """Reading for every user, writing by list, changing the address space for nobody."""

    def __init__(self, writes: Mapping[str, Sequence[str]] | None, counts: dict[str, int]) -> None:
        self._writes, self._counts = writes, counts
        self._allowed = {ua.NodeId(kind) for kind in USER_TYPES} - {
            ua.NodeId(ua.ObjectIds.CallRequest_Encoding_DefaultBinary)
        }
        self._write = ua.NodeId(ua.ObjectIds.WriteRequest_Encoding_DefaultBinary)
        self.names: dict[ua.NodeId, str] = {}

    def check_validity(self, user: User, action_type_id: ua.NodeId, body: Any) -> bool:
        """Whether a request is carried out."""
        allowed = action_type_id in self._allowed
        if allowed and action_type_id == self._write and self._writes is not None:
            mine = self._writes.get(user.name or "", ())
            request = struct_from_binary(ua.WriteParameters, body.copy())  # the server reads the body itself after this
            allowed = all(self.names.get(item.NodeId) in mine for item in request.NodesToWrite)
        self._counts["node"] += not allowed
        return allowed


class OpcuaServer:
    """A server of named numbers.

    Args:
        name: of the server and of the object that holds the nodes.
        uri: of its namespace and application.
        url: where it listens.
        access: who may do what.

    Raises:
        GatewayError: if it is to listen beyond this machine without encryption.
    """

    def __init__(self, name: str, uri: str, url: str, access: Access) -> None:
        host = url.split("//")[-1].split("/")[0].rsplit(":", 1)[0]
        if access.pki is None and not is_loopback(host):
            raise GatewayError(f"{url}: without certificates a server may listen on 127.0.0.1 only")
        self.refused = {"user": 0, "certificate": 0, "node": 0}
        self._name, self._uri, self._url, self._access = name, uri, url, access
        self._rules = _Rules(access.writes if access.pki else None, self.refused)
        self._ids: dict[str, ua.NodeId] = {}
        self._types: dict[str, ua.VariantType] = {}
        self._server: Server | None = None

    async def start(self, numbers: Mapping[str, Any], writable: Sequence[str] = ()) -> None:
        """Listens.

        Args:
            numbers: value of every node at the start: a number, a list of numbers or a text.
            writable: names of the nodes that clients may write, if `Access` lets them.

        Raises:
            GatewayError: if the port cannot be had.
        """
        access = self._access
        users = _Users(access.users, self.refused) if access.pki else None
        server = Server(user_manager=users)
        await server.init()
        server.set_endpoint(self._url)
        server.set_server_name(self._name)
        await server.set_application_uri(self._uri)
        if access.pki is not None:
            await self._secure(server, Pki(access.pki, self._uri))
        else:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity], permission_ruleset=self._rules)
        await self._fill(server, numbers, writable)
        try:
            await server.start()
        except OSError as error:
            raise GatewayError(f"cannot listen on {self._url}: {error.strerror}") from None
        self._server = server

    async def put(self, name: str, value: Any, *, status: int = 0, time: datetime | None = None) -> None:
        """Sets a node, with source time (default: now) and status code."""
        assert self._server is not None
        now = time or datetime.now(tz=UTC).replace(tzinfo=None)
        data = ua.DataValue(
            ua.Variant(value, self._types[name]), ua.StatusCode(status), SourceTimestamp=now, ServerTimestamp=now
        )
        await self._server.write_attribute_value(self._ids[name], data)

    def get(self, name: str) -> Any:
        """The value of a node."""
        assert self._server is not None
        return self._server.read_attribute_value(self._ids[name]).Value.Value

    async def stop(self) -> None:
        """Closes every session and stops listening."""
        if self._server is not None:
            await self._server.stop()
            self._server = None
            await asyncio.sleep(_CLOSING)

    async def _secure(self, server: Server, pki: Pki) -> None:
        async def validate(certificate: x509.Certificate, _application: object) -> None:
            if not pki.trusts(certificate.public_bytes(Encoding.DER)):
                self.refused["certificate"] += 1
                raise ServiceError(ua.StatusCodes.BadCertificateUntrusted)

        await server.load_certificate(str(pki.certificate))
        await server.load_private_key(str(pki.key))
        server.set_certificate_validator(validate)
        server.set_security_policy(
            [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt], permission_ruleset=self._rules
        )
        server.set_identity_tokens([ua.UserNameIdentityToken])

    async def _fill(self, server: Server, numbers: Mapping[str, Any], writable: Sequence[str]) -> None:
        index = await server.register_namespace(self._uri)
        top = await server.nodes.objects.add_object(ua.NodeId(self._name, index), self._name)
        for name, value in numbers.items():
            first = value[0] if isinstance(value, list) and value else value
            kind = (
                ua.VariantType.String
                if isinstance(first, str)
                else ua.VariantType.UInt32
                if isinstance(first, int)
                else ua.VariantType.Double
            )
            node = await top.add_variable(ua.NodeId(name, index), name, value, kind)
            if name in writable:
                await node.set_writable()
            self._ids[name], self._types[name], self._rules.names[node.nodeid] = node.nodeid, kind, name
