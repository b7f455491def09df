"""The server of the sink `opcua`, over the library asyncua: variables of points, and writes that go through the run.

Quality becomes a status code: good is Good; stale is UncertainLastUsableValue with the last value, before there is one
BadWaitingForInitialData; failed is Bad without a value (OPC UA part 8, section 6.3).
"""

from __future__ import annotations

import asyncio
import hmac
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Protocol

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager

from framekit.run.model import Point
from framekit.run.points import PointValue, unscaled
from framekit.sinks.base import Host, value_type
from framekit.sinks.secrets import Secret

LONGEST_WRITE = 60
"""Longest time (s) that a client waits until its value is written."""

UNITS = "http://www.opcfoundation.org/UA/units/un/cefact"
"""The namespace of units; without a number in the list (-1) the text is valid (OPC UA part 8, section 5.6.3)."""

_TYPES = {
    "string": (ua.VariantType.String, str),
    "bool": (ua.VariantType.Boolean, bool),
    "int64": (ua.VariantType.Int64, int),
    "uint64": (ua.VariantType.UInt64, int),
}
_FLOAT = (ua.VariantType.Double, float)
"""Also the type of whole numbers beyond 64 bits."""

_SAFE = (
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
)


class ServerSettings(Protocol):
    """The keys of the sink that concern its server; empty if not given."""

    @property
    def opcua(self) -> tuple[str, int]: ...
    @property
    def target(self) -> str: ...
    @property
    def certificate(self) -> str: ...
    @property
    def private_key(self) -> str: ...
    @property
    def user(self) -> str: ...
    @property
    def password(self) -> Secret | None: ...


class PointServer:
    """A server with a folder for the run, in which each point is a variable whose id is its name."""

    def __init__(self, kind: ServerSettings, host: Host, points: Sequence[Point]) -> None:
        self.kind, self.host = kind, host
        self.points = {point.name: point for point in points}
        self.ids: Mapping[ua.NodeId, Point] = {}
        self._inner = _InnerServer(self, _OneUser(kind) if kind.user else _Reader())
        self._server = Server(iserver=self._inner)
        self._nodes: dict[str, ua.NodeId] = {}
        self._reasons: dict[str, ua.NodeId] = {}

    @property
    def port(self) -> int:
        """Return the number of the port on which it listens."""
        running = self._server.bserver
        return self.kind.opcua[1] if running is None else int(running.port)

    async def start(self, values: Sequence[PointValue]) -> None:
        """Start the server; each point has the given value. Raises OSError, ValueError."""
        server, kind = self._server, self.kind
        await server.init()
        name = f"framekit {self.host.run}"
        server.set_server_name(name)
        server.set_endpoint(kind.target)
        server.product_uri = "urn:framekit"
        await server.set_application_uri(f"urn:framekit:{self.host.run}")
        if kind.certificate:
            await server.load_certificate(kind.certificate)
            await server.load_private_key(kind.private_key)
        server.set_security_policy(list(_SAFE) if kind.certificate else [ua.SecurityPolicyType.NoSecurity])
        server.set_identity_tokens([ua.UserNameIdentityToken if kind.user else ua.AnonymousIdentityToken])
        space = await server.register_namespace(f"urn:framekit:{self.host.run}:points")
        folder = await server.nodes.objects.add_folder(space, self.host.run)
        for value in values:
            await self._add(folder, space, self.points[value.name])
        self.ids = {node: self.points[name] for name, node in self._nodes.items()}
        await self.take(values)
        await server.start()

    async def _add(self, folder: Any, space: int, point: Point) -> None:
        kind, python = _TYPES.get(value_type(point), _FLOAT)
        name = ua.QualifiedName(point.name, space)
        variable = await folder.add_variable(ua.NodeId(point.name, space), name, python(), kind)
        if point.is_writable:
            await variable.set_writable()
        reason = await variable.add_property(space, "Reason", "", ua.VariantType.String)
        if point.unit:
            unit = ua.EUInformation(NamespaceUri=UNITS, UnitId=-1, DisplayName=ua.LocalizedText(point.unit))
            await variable.add_property(0, "EngineeringUnits", unit)
        if point.limits is not None:
            low, high = point.limits
            await variable.add_property(0, "EURange", ua.Range(Low=float(low), High=float(high)))
        self._nodes[point.name], self._reasons[point.name] = variable.nodeid, reason.nodeid

    async def take(self, values: Sequence[PointValue]) -> None:
        """Set the variables to these values, in their order."""
        for value in values:
            await self._inner.aspace.write_attribute_value(
                self._nodes[value.name], ua.AttributeIds.Value, _data_value(self.points[value.name], value)
            )
            reason = ua.DataValue(ua.Variant(value.reason, ua.VariantType.String))
            await self._inner.aspace.write_attribute_value(self._reasons[value.name], ua.AttributeIds.Value, reason)

    async def stop(self) -> None:
        """Stop the server and all its connections."""
        await self._server.stop()

    async def write(self, asked: ua.WriteValue, who: str) -> ua.StatusCode:
        """Write a value from a client; the status follows when the device has the value."""
        point = self.ids.get(asked.NodeId)
        if point is None or not point.is_writable:
            return ua.StatusCode(ua.StatusCodes.BadNotWritable)
        if asked.AttributeId != ua.AttributeIds.Value or asked.IndexRange:
            return ua.StatusCode(ua.StatusCodes.BadWriteNotSupported)
        variant, code = asked.Value.Value, asked.Value.StatusCode
        value = None if variant is None else variant.Value
        if not isinstance(value, (bool, int, float, str)) or (code is not None and not code.is_good()):
            return ua.StatusCode(ua.StatusCodes.BadTypeMismatch)
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[str] = loop.create_future()

        def told(why: str) -> None:
            loop.call_soon_threadsafe(lambda: None if answer.done() else answer.set_result(why))

        try:
            await asyncio.to_thread(self.host.write, point.name, value, who, told)
            why = await asyncio.wait_for(answer, LONGEST_WRITE)
        except TimeoutError:
            return ua.StatusCode(ua.StatusCodes.BadTimeout)
        if not why:
            return ua.StatusCode(ua.StatusCodes.Good)
        return ua.StatusCode(_refusal(point, value))


def _refusal(point: Point, value: Any) -> Any:
    """Return the status for a refused value: it is invalid for the point, or the device did not accept it."""
    try:
        unscaled(point, value)
    except ValueError:
        return ua.StatusCodes.BadOutOfRange
    return ua.StatusCodes.BadCommunicationError


def _data_value(point: Point, value: PointValue) -> ua.DataValue:
    """Return a value as clients get it."""
    kind, python = _TYPES.get(value_type(point), _FLOAT)
    code = ua.StatusCodes.Good
    if value.quality == "failed":
        code = ua.StatusCodes.Bad
    elif value.quality == "stale":
        code = (
            ua.StatusCodes.BadWaitingForInitialData if value.value is None else ua.StatusCodes.UncertainLastUsableValue
        )
    is_there = value.value is not None and value.quality != "failed"
    variant = ua.Variant(python(value.value), kind) if is_there else ua.Variant(None, ua.VariantType.Null)
    time = datetime.fromtimestamp(value.time / 1e9, UTC) if value.time else None
    return ua.DataValue(variant, ua.StatusCode(code), SourceTimestamp=time, ServerTimestamp=datetime.now(UTC))


class _InnerServer(InternalServer):
    """The library's server, whose sessions write through the run."""

    def __init__(self, points: PointServer, users: UserManager) -> None:
        super().__init__(user_manager=users)
        self.points = points
        self.allow_remote_admin = False

    def create_session(self, name: Any, user: Any = None, external: bool = False) -> Any:
        user = user or User(role=UserRole.Anonymous)
        return _Session(self, self.aspace, self.subscription_service, name, user=user, external=external)


class _Session(InternalSession):
    """A client's session."""

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        server = self.iserver
        assert isinstance(server, _InnerServer)
        where = ":".join(map(str, self.name[:2])) if isinstance(self.name, tuple) else str(self.name)
        who = f"{self.user.name or 'a client'!r} at {where} by OPC UA"
        return [await server.points.write(one, who) for one in params.NodesToWrite]


class _Reader(UserManager):
    """Access for every user who reaches the port."""

    def get_user(self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None) -> User:
        return User(role=UserRole.User)


class _OneUser(UserManager):
    """A single user with a password. Raises OSError, ValueError if the password cannot be read."""

    def __init__(self, kind: ServerSettings) -> None:
        assert kind.password is not None
        self.name, self._password = kind.user, kind.password.read()

    def get_user(
        self, iserver: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        given = password.encode() if isinstance(password, str) else password or b""
        is_right = hmac.compare_digest(given, self._password.encode())
        return User(role=UserRole.User, name=self.name) if is_right and username == self.name else None
