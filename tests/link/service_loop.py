"""A client and a server of one protocol, connected by bytes only: without line, time and sequences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.protocol import Protocol
from framekit.link.events import Command, Exchange, Outcome, Served
from framekit.link.frame_table import FrameTable
from framekit.link.scope import Scope, with_date
from framekit.link.services.client import ServiceClient, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.link.values import FrameValue, Names
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

FRAMES = Path(__file__).parents[2] / "frames"
DATA = Path(__file__).parents[1] / "data"


@cache
def codec_of(protocol_key: str) -> tuple[Protocol, Any]:
    """Return a protocol from a name, a file of tests/data, or a text, with its codec."""
    if "\n" in protocol_key:
        protocol = load_protocol_text(protocol_key, "made_up", FRAMES)
    else:
        file = DATA / protocol_key
        protocol = load_protocol(file if file.is_file() else protocol_key, FRAMES)
    return protocol, compile_protocol(protocol)


class Loop:
    """A replacement of the client's engine; `log` holds (request, reply, served) of every exchange.

    `outcomes` are reported instead of the server's replies. `damage` changes a reply before the client receives it.
    """

    def __init__(
        self,
        protocol: str,
        *,
        memory: DeviceMemory | None = None,
        params: Mapping[str, Any] | None = None,
        own: Any = 1,
        role: str = "server",
        client_role: str = "client",
        **server: Any,
    ) -> None:
        self.protocol, codec = codec_of(protocol)
        self.table = FrameTable(self.protocol, codec)
        self.scope = Scope(self.protocol, role=client_role, own=own, params=params)
        self.need_names = frozenset(self.protocol.frames)
        self.device = Scope(self.protocol, role=role, own=own, params=params)
        self.device["functions"] = SimpleNamespace(with_date=with_date)
        self.troubles: list[str] = []
        self.memory = memory or DeviceMemory(memory_of(self.protocol)[0])
        self.server = MemoryServer(self.protocol, codec, self.memory, **server)
        self.client = ServiceClient(self.protocol, codec, self)
        self.log: list[tuple[bytes, bytes, Served]] = []
        self.damage: Callable[[FrameValue], FrameValue] = lambda reply: reply
        self.outcomes: list[Outcome] = []

    # ---- the engine's part --------------------------------------------------------------------------------

    def start(self, exchange: Exchange, now: int) -> list[Command]:
        names = Names({"buffer": exchange.buffer, "station": exchange.station}, self.scope)
        assert exchange.request is not None
        names["request"] = exchange.request
        raw = self.table.encode(exchange.request, names)
        served = self.serve(self.arrived(exchange.request.frame, raw), exchange.buffer, exchange.station)
        reply = self._back(served, exchange, names)
        self.log.append((raw, b"" if reply is None else reply.raw or b"", served))
        if self.outcomes:
            outcome = self.outcomes.pop(0)
            if outcome.ok:
                exchange.taken = outcome.reply
                exchange.succeeded({"reply": outcome.reply, "buffer": outcome.buffer, **outcome.results})
            else:
                exchange.ended(outcome)
        elif reply is None and served.refusal:
            exchange.ended(Outcome(False, "aborted"))
        else:
            exchange.taken = reply
            exchange.succeeded({"reply": reply, "buffer": served.reply_buffer})
        return []

    def _back(self, served: Served, exchange: Exchange, names: Names) -> FrameValue | None:
        if served.reply is None:
            return None
        known = Names({"request": exchange.request, "buffer": served.reply_buffer}, self.device)
        raw = self.table.encode(served.reply, known)
        info = self.table.infos[served.reply.frame]
        reply = self.damage(self.table.received(served.reply.frame, info.decode(raw, names), raw, None))
        assert reply.frame in exchange.expected
        return reply

    # ---- the device's part --------------------------------------------------------------------------------

    def arrived(self, frame: str, raw: bytes) -> FrameValue:
        """Return a frame as the receiver delivers it, also if it is to be refused. Raises FrameError."""
        try:
            return self.table.received(frame, self.table.infos[frame].decode(raw, self.device), raw, None)
        except FrameError as error:
            if error.refuse is None:
                raise
            return FrameValue(frame, dict(error.fields), raw, error.refuse)

    def request(self, raw: bytes, group: str = "request") -> FrameValue:
        """Return the first frame of the group that fits the bytes or is to be refused."""
        for frame in self.protocol.frames_of(group):
            try:
                return self.arrived(frame, raw)
            except FrameError:
                continue
        raise AssertionError(f"{raw!r} is no request")

    def serve(self, request: FrameValue, buffer: bytes = b"", station: Any = None, check: bool = False) -> Served:
        served = self.server.serve(request, buffer, station, check, self.device)
        if served.trouble:
            self.troubles.append(served.trouble)
        return served

    def answer(self, raw: bytes) -> bytes:
        """Return the server's reply to these bytes."""
        request = self.request(raw)
        served = self.serve(request)
        assert served.reply is not None
        return self.table.encode(served.reply, Names({"request": request, "buffer": served.reply_buffer}, self.device))

    # ---- what tests ask -----------------------------------------------------------------------------------

    def do(self, method: str, *arguments: Any, **options: Any) -> TransferResult:
        """Run a method of the client to its end."""
        results: list[TransferResult] = []
        getattr(self.client, method)(*arguments, now=0, on_done=results.append, **{"station": 1, **options})
        assert len(results) == 1
        return results[0]

    @property
    def requests(self) -> list[bytes]:
        return [raw for raw, _, _ in self.log]
