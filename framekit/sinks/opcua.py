"""Values as variables of an OPC UA server, which clients read, subscribe to, and write where a point has access: rw.

The server itself, over a library, is in `opcua_server`.
"""

from __future__ import annotations

import asyncio
import logging
import socket
import threading
from collections.abc import Coroutine, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framekit.definition.keys import Form, key, ref
from framekit.run.model import Point
from framekit.run.points import PointValue
from framekit.sinks.base import LISTENING, READ_FILE, Host, Sampled, Sink, SinkKind, not_installed
from framekit.sinks.secrets import SECRET, Secret
from framekit.transport.network import bracketed

if TYPE_CHECKING:
    from framekit.sinks.opcua_server import PointServer

log = logging.getLogger(__name__)
logging.getLogger("asyncua").addHandler(logging.NullHandler())  # its tracebacks are not for the terminal

LONGEST = 30
"""Time limit (s) for the server to start, to take values and to end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opcua(SinkKind):
    """An OPC UA server with a variable for each point."""

    word: ClassVar[str] = "opcua"
    opcua: tuple[str, int] = key(
        "opcua", LISTENING,
        "The port of the OPC UA server, on 127.0.0.1 unless ADDRESS:PORT says another address; 0: a free one.",
    )  # fmt: skip
    certificate: str = key(
        "certificate", READ_FILE, "The server's certificate (PEM or DER): only clients that sign and encrypt come in.",
        default="",
    )  # fmt: skip
    private_key: str = key("private_key", READ_FILE, "The private key of the certificate (PEM or DER).", default="")
    user: str = key(
        "user", Form(ref("text"), lambda r, node: r.reader.text(node)),
        "The name that a client has to give; default: anyone who reaches the port may read and write.", default="",
    )  # fmt: skip
    password: Secret | None = key(
        "password", SECRET, "Where the password stands: env:NAME, a variable of the environment, or file:NAME, a file "
        "beside the run.", default=None,
    )  # fmt: skip

    @property
    def target(self) -> str:
        host, port = self.opcua
        return f"opc.tcp://{bracketed(host)}:{port}"

    @property
    def listens(self) -> tuple[str, int]:
        return self.opcua

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        yield from not_installed("asyncua", "asyncua")
        if bool(self.certificate) != bool(self.private_key):
            given, missing = ("certificate", "private_key") if self.certificate else ("private_key", "certificate")
            yield given, f"'{given}' needs '{missing}'", f"give both, or remove '{given}'"
        if bool(self.user) != (self.password is not None):
            given, missing = ("user", "password") if self.user else ("password", "user")
            yield given, f"'{given}' needs '{missing}'", f"give both, or remove '{given}'"
        if self.user and not self.certificate:
            yield "user", "the password would cross the network for all to read", "give a certificate and a private_key"

    def make(self) -> Sink:
        return OpcuaSink(self)


def require_free(address: tuple[str, int]) -> None:
    """Raise OSError if no server can listen at the address: the library works for seconds before it tries."""
    family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
    socket.create_server(address, family=family).close()


class OpcuaSink(Sink):
    """Runs the server in a thread of its own. Raises OSError, ValueError."""

    def __init__(self, kind: Opcua) -> None:
        self.kind = kind
        self.port = kind.opcua[1]
        self._host: Host | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._server: PointServer | None = None

    def meet(self, host: Host) -> None:
        self._host = host

    def open(self, points: Sequence[Point]) -> None:
        from framekit.sinks.opcua_server import PointServer

        assert self._host is not None
        require_free(self.kind.opcua)
        now = {value.name: value for value in self._host.values()}
        self._loop = loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=loop.run_forever, name="opcua", daemon=True)
        self._thread.start()
        self._server = PointServer(self.kind, self._host, points)
        self._wait(self._server.start([now.get(point.name, PointValue(point.name)) for point in points]))
        self.port = self._server.port
        log.info("sink opcua: opc.tcp://%s:%d", bracketed(self.kind.opcua[0]), self.port)

    def write(self, samples: Sequence[Sampled]) -> int:
        if self._server is None:
            raise ConnectionError("the server does not run")
        self._wait(self._server.take([value for sample in samples for value in sample.values]))
        return len(samples)

    def close(self) -> None:
        loop, thread, server = self._loop, self._thread, self._server
        self._loop = self._thread = self._server = None
        if loop is None or thread is None:
            return
        try:
            if server is not None:
                asyncio.run_coroutine_threadsafe(server.stop(), loop).result(LONGEST)
        finally:
            loop.call_soon_threadsafe(loop.stop)
            thread.join(LONGEST)
            if not thread.is_alive():
                loop.close()

    def _wait(self, work: Coroutine[Any, Any, None]) -> None:
        assert self._loop is not None
        asyncio.run_coroutine_threadsafe(work, self._loop).result(LONGEST)
