"""TLS over TCP, `tls://HOST:PORT`: a connecting port, and a listener that offers connections after a good handshake.

Options follow `?` in the name of the port, as PEM files: `ca` and `name` for a client, `clients` for a listener, `cert`
and `key` for both. Files are read whenever a port is opened; a listener detects changes of its files. So a new
certificate needs no restart. No key, and no content of its file, is ever shown.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import ssl
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from urllib.parse import parse_qsl, quote, urlencode

from framekit.definition.problems import did_you_mean, error_text
from framekit.transport.clock import AsyncioClock
from framekit.transport.network import (
    FAR_END_CLOSED,
    AcceptedConnection,
    Connection,
    NetworkListener,
    TcpAcceptedPort,
    TcpPort,
    bracketed,
)
from framekit.transport.port import Accepted

log = logging.getLogger(__name__)

OF_CLIENTS = ("ca", "name", "cert", "key")
OF_SERVERS = ("cert", "key", "clients")
FILES = ("ca", "cert", "key", "clients")
SERVER_FORM = "tls://HOST:PORT?cert=FILE&key=FILE"

HANDSHAKE_WITHIN = 10.0
"""Time limit of a handshake (s)."""
SHUTDOWN_WITHIN = 2.0
"""Time limit for the other side to confirm the closing (s)."""
MOST_HANDSHAKES = 64
"""Largest number of handshakes in progress; a further handshake replaces the oldest of the address with the most."""
MOST_OF_ONE_ADDRESS = 16
"""Largest number of handshakes in progress from one address; a further handshake replaces the oldest of that
address.
"""
ACCEPTS_AGAIN = 1.0
"""Pause after the system could not accept a connection (s)."""

_REASONS = {
    "WRONG_VERSION_NUMBER": "the other side does not speak TLS",
    "HTTP_REQUEST": "the other side does not speak TLS",
    "UNEXPECTED_EOF_WHILE_READING": FAR_END_CLOSED,
    "TLSV13_ALERT_CERTIFICATE_REQUIRED": "the other side wants a certificate – give cert= and key=",
    "PEER_DID_NOT_RETURN_A_CERTIFICATE": "the other side has no certificate",
    "TLSV1_ALERT_UNKNOWN_CA": "the other side does not know who signed the certificate",
    "SSLV3_ALERT_BAD_CERTIFICATE": "the other side refuses the certificate",
    "SSLV3_ALERT_CERTIFICATE_EXPIRED": "the other side says that the certificate has expired",
}


# ---- names of ports ---------------------------------------------------------------------------------------------


def parted(url: str) -> tuple[str, dict[str, str]]:
    """Return the URL without the query, and the options of the query by name.

    Raises ValueError for an unknown option.
    """
    place, _, query = url.partition("?")
    found: dict[str, str] = {}
    for name, value in parse_qsl(query, keep_blank_values=True):
        if name not in (*OF_CLIENTS, *OF_SERVERS):
            known = list(dict.fromkeys((*OF_CLIENTS, *OF_SERVERS)))
            raise ValueError(f"a tls: port has no '{name}' – {did_you_mean(name, known)}")
        if name in found or not value.strip():
            raise ValueError(f"'{name}' of a tls: port names {'two things' if name in found else 'nothing'} – name one")
        found[name] = value
    if "key" in found and "cert" not in found:
        raise ValueError("a tls: port has a key and no certificate – add cert=FILE")
    return place, found


def placed(url: str, folder: Path) -> str:
    """Return the URL with relative file names resolved in `folder`. Raises ValueError."""
    place, given = parted(url)
    for name in FILES:
        if name in given:
            given[name] = str(folder / given[name])
    return f"{place}?{urlencode(given, quote_via=quote, safe='/')}" if given else place


def _check_side(given: Mapping[str, str], known: tuple[str, ...], what: str) -> None:
    wrong = next((name for name in given if name not in known), None)
    if wrong is not None:
        raise ValueError(f"'{wrong}' is nothing for a tls: port that {what} – known are {', '.join(known)}")


# ---- certificates -----------------------------------------------------------------------------------------------


def client_context(given: Mapping[str, str]) -> ssl.SSLContext:
    """Return the TLS context of a client. Raises OSError, with the name of a file that cannot be used."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.hostname_checks_common_name = False  # only the alternative names identify the host
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if "ca" in given:
        _trust(context, given["ca"])
    else:
        context.load_default_certs(ssl.Purpose.SERVER_AUTH)
    if "cert" in given:
        _show(context, given)
    return context


def server_context(given: Mapping[str, str]) -> ssl.SSLContext:
    """Return the TLS context of a server. Raises OSError, with the name of a file that cannot be used."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _show(context, given)
    if "clients" in given:
        _trust(context, given["clients"])
        context.verify_mode = ssl.CERT_REQUIRED
    return context


def _trust(context: ssl.SSLContext, file: str) -> None:
    try:
        context.load_verify_locations(file)
    except ssl.SSLError:
        raise OSError(f"{file} holds no certificates in PEM") from None
    except OSError as error:
        raise OSError(f"{file}: {error_text(error)}") from None


def _show(context: ssl.SSLContext, given: Mapping[str, str]) -> None:
    cert, key = given["cert"], given.get("key")
    for file in (cert, key):
        if file is not None and not os.access(file, os.R_OK):
            raise OSError(f"{file}: it is not there, or may not be read")
    try:
        context.load_cert_chain(cert, key, password=_no_password)
    except PermissionError as error:
        raise OSError(str(error)) from None
    except (OSError, ValueError):
        files = cert if key is None else f"{cert} and {key}"
        raise OSError(f"{files}: they hold no certificate in PEM with the key that fits it") from None


def _no_password() -> str:
    """Raise PermissionError, because the library would otherwise ask for the password on the terminal."""
    raise PermissionError("the key has a password, and a port cannot ask for it – keep the key in a file without one")


def why(error: Exception) -> str:
    """Return the reason for a failed handshake or a lost connection, as a text for users."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate of the other side is not good: {error.verify_message.rstrip('.')}"
    if isinstance(error, ssl.SSLError):
        name = error.reason or ""
        return _REASONS.get(name) or f"TLS: {name.lower().replace('_', ' ') or 'it failed'}"
    if isinstance(error, ConnectionAbortedError):
        return f"no handshake within {HANDSHAKE_WITHIN:g} s"
    return FAR_END_CLOSED if isinstance(error, ConnectionResetError) else error_text(error)


# ---- connecting -------------------------------------------------------------------------------------------------


class TlsPort(TcpPort):
    """Connection to a server whose certificate is trusted and names the host.

    Raises ValueError for options in `given` that are invalid for a client.
    """

    def __init__(
        self, host: str, number: int, given: Mapping[str, str], clock: AsyncioClock, connect_within: int | None = None
    ) -> None:  # fmt: skip
        _check_side(given, OF_CLIENTS, "connects")
        self._given = given
        self._has_heard = False
        super().__init__(host, number, clock, connect_within)
        self.name = f"tls://{bracketed(host)}:{number}"

    async def connect(self, connection: Connection) -> None:
        context = client_context(self._given)
        try:
            await self.clock.loop.create_connection(
                lambda: connection, self.host, self.number, ssl=context,
                server_hostname=self._given.get("name", self.host),
                ssl_handshake_timeout=HANDSHAKE_WITHIN, ssl_shutdown_timeout=SHUTDOWN_WITHIN,
            )  # fmt: skip
        except (ssl.SSLError, ConnectionAbortedError, ConnectionResetError) as error:
            raise OSError(why(error)) from None

    def connected(self) -> None:
        self._has_heard = False
        super().connected()

    def hear(self, data: bytes) -> None:
        self._has_heard = True
        super().hear(data)

    def lost(self, reason: str) -> None:
        if reason == FAR_END_CLOSED and not self._has_heard and "cert" not in self._given:
            reason += " – it may want a certificate: give cert= and key="  # TLS 1.3 reports that after the handshake
        super().lost(reason)

    def why_lost(self, error: Exception) -> str:
        return why(error)


# ---- listening --------------------------------------------------------------------------------------------------


class TlsListener(NetworkListener):
    """Accept connections, and offer those whose handshake succeeds; the reason of a failed handshake is logged.

    Raises ValueError for options in `given` that are invalid for a server, and if the certificate is missing.
    """

    scheme, reached_by, kind = "tls", "tls", socket.SOCK_STREAM

    def __init__(
        self, host: str, number: int, given: Mapping[str, str], clock: AsyncioClock, accepted: Accepted
    ) -> None:  # fmt: skip
        _check_side(given, OF_SERVERS, "listens")
        self._given = given
        if "cert" not in given:
            raise ValueError(f"a tls: port that listens needs a certificate and its key – write {SERVER_FORM}")
        super().__init__(host, number, clock, accepted)
        self._context: ssl.SSLContext | None = None
        self._loaded: list[tuple[int, int, int] | None] = []
        """State of the files when they were last read."""
        self._handshakes: dict[asyncio.Task[None], str] = {}
        """Address of each handshake in progress, the oldest first."""

    def _bound(self, family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
        self._loaded = self._files()
        self._context = server_context(self._given)
        return socket.create_server(address, family=family)

    def _files(self) -> list[tuple[int, int, int] | None]:
        """Return the present state of the files; None for a missing file."""
        return [_stamp(self._given[name]) for name in FILES if name in self._given]

    def _context_now(self) -> ssl.SSLContext:
        """Return the context of the present files; while they cannot be used, such as during a replacement, the
        previous context. Raises OSError if no previous context exists.
        """
        files = self._files()
        if self._context is None or files != self._loaded:
            self._loaded = files
            try:
                self._context = server_context(self._given)
                log.info("%s: its certificate was read anew", self.name)
            except OSError as error:
                if self._context is None:
                    raise
                log.warning("%s goes on with the certificate that it has: %s", self.name, error)
        return self._context

    async def _open(self, listening: socket.socket) -> None:
        listening.setblocking(False)
        self._at_work = Acceptance(listening, self.clock.loop.create_task(self._accept(listening)))

    async def _accept(self, listening: socket.socket) -> None:
        loop = self.clock.loop
        while True:
            try:
                connected, address = await loop.sock_accept(listening)
            except OSError as error:
                if listening.fileno() < 0:
                    return
                log.warning("%s accepts nothing for now: %s", self.name, error)
                await asyncio.sleep(ACCEPTS_AGAIN)
                continue
            host = str(address[0])
            if not self.admits(host):
                connected.close()
                continue
            self._make_room(host)
            handshake = loop.create_task(self._shake_hands(connected, f"{bracketed(host)}:{address[1]}"))
            self._handshakes[handshake] = host
            handshake.add_done_callback(partial(self._ended, connected))
            await asyncio.sleep(0)  # otherwise waiting connections would hold up the loop

    def _make_room(self, host: str) -> None:
        """Cancel the oldest handshake if there are too many: idle connections must not block others."""
        each = Counter(self._handshakes.values())
        if each[host] >= MOST_OF_ONE_ADDRESS:
            in_the_way = host
        elif len(self._handshakes) >= MOST_HANDSHAKES:
            in_the_way = max(each, key=lambda one: each[one])
        else:
            return
        oldest = next(one for one, of in self._handshakes.items() if of == in_the_way)
        del self._handshakes[oldest]
        oldest.cancel()
        self.refused(in_the_way)

    def _ended(self, connected: socket.socket, handshake: asyncio.Task[None]) -> None:
        self._handshakes.pop(handshake, None)
        if handshake.cancelled():
            connected.close()

    async def _shake_hands(self, connected: socket.socket, client: str) -> None:
        def protocol() -> AcceptedConnection:
            return AcceptedConnection(TcpAcceptedPort(self.host, self.clock), self.accepted, "tls")

        try:
            await self.clock.loop.connect_accepted_socket(
                protocol, connected, ssl=self._context_now(),
                ssl_handshake_timeout=HANDSHAKE_WITHIN, ssl_shutdown_timeout=SHUTDOWN_WITHIN,
            )  # fmt: skip
        except OSError as error:
            connected.close()
            log.warning("%s: no handshake with %s: %s", self.name, client, why(error))

    def stop(self) -> None:
        super().stop()
        for handshake in list(self._handshakes):
            handshake.cancel()


def _stamp(file: str) -> tuple[int, int, int] | None:
    """Return modification time (ns), size and inode of a file; None if it is missing."""
    try:
        found = os.stat(file)
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


class Acceptance:
    """A socket on which connections are accepted, until it is closed."""

    def __init__(self, listening: socket.socket, task: asyncio.Task[None]) -> None:
        self._listening, self._task = listening, task

    def close(self) -> None:
        self._task.cancel()
        with contextlib.suppress(OSError):
            self._listening.close()
