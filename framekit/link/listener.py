"""Listen to a line between other stations: frames of both sides on the same wires, or on two. A listener never sends.

Sans-I/O like the engine: it receives bytes and times, and reports frames to its monitor. It does not follow sequences:
the last speaker decides which side is expected next, and this only decides which frames are tried first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal

from framekit.codec.shown import code_text, explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER, LineFormat, parse_format
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived, ReportedBytes
from framekit.link.events import CharacterFault, Kind, LinkCounters, Monitor, Seen
from framekit.link.frame_table import ProtocolCodec, announce, table_of
from framekit.link.receiver import Receiver
from framekit.link.scope import LinkFunctions, Scope
from framekit.link.values import EVALUATION_ERRORS, FrameValue, Names

Direction = Literal["in", "out", ""]
Side = Literal["client", "server"]

LONGEST_PAUSE = 1_000_000_000
"""The silence (ns) that ends an unfinished frame if the definition has no `gap`. Without it, the frame would never end.
"""


class _Wires:
    """The state of one direction. `side`: the side that speaks in this direction, or None for both."""

    def __init__(self, receiver: Receiver, direction: Direction, side: Side | None) -> None:
        self.receiver = receiver
        self.direction: Direction = direction
        self.side = side
        self.cut_at = NEVER
        self.reported = ReportedBytes()


class Listener:
    """Find the frames on a line. `client`: the direction of the client, if the directions are separate.

    `monitor` receives frames, bad frames, noise, breaks and trouble, each with its own time. Raise ParameterError for
    parameters that do not fit; no method raises.
    """

    def __init__(
        self,
        protocol: Protocol,
        codec: ProtocolCodec,
        monitor: Monitor,
        *,
        params: Mapping[str, Any] | None = None,
        line: LineFormat | None = None,
        now: int = 0,
        client: Literal["in", "out"] | None = None,
    ) -> None:
        if line is None and protocol.line.kind == "serial":
            line = parse_format(protocol.line.format, protocol.line.speed)
        self.protocol = protocol
        self.monitor = monitor
        self.counters = LinkCounters()
        self.scope = Scope(protocol, line=line, params=params, now=now)
        self.scope["functions"] = LinkFunctions(self.scope)
        self.table = table_of(protocol, codec)
        self._codec = codec
        self._names = Names({"request": None, "buffer": b""}, self.scope)
        self._client = client
        self._wires: dict[Direction, _Wires] = {}
        self._frames = self._sides()
        self._announcing = any(info.announces for info in self.table.infos.values())
        self._next_side: Side = "client"
        self._hears_marks = False
        self._has_exact_times = True

    def hear_late(self) -> None:
        """Note, before any byte, that a time of bytes is the time of their reading: only `tick` ends a frame by a
        pause.
        """
        self._has_exact_times = False

    def hear_marks(self) -> None:
        """Note that the port or the capture reports the ninth bits of characters."""
        line = self.scope.line.line
        self._hears_marks = self.protocol.line.has_marks and line is not None and line.has_marks
        for wires in self._wires.values():
            wires.receiver.hear_marks(self._hears_marks)

    def _sides(self) -> dict[Side, tuple[tuple[str, ...], tuple[str, ...]]]:
        """Return the frames to expect from each side: its own and common frames, then those of the other side."""

        def of(*sides: str) -> tuple[str, ...]:
            return tuple(name for name in self.table.on_line if self.table.infos[name].frame.side in sides)

        return {"client": (of("client", "both"), of("server")), "server": (of("server", "both"), of("client"))}

    def _wire(self, direction: Direction) -> _Wires:
        wires = self._wires.get(direction)
        if wires is None:
            receiver = Receiver(self._codec, self.protocol, self._names, self.table, self._trouble)
            receiver.hear_marks(self._hears_marks)
            receiver.has_exact_times = self._has_exact_times
            side: Side | None = None
            if self._client is not None and direction:
                side = "client" if direction == self._client else "server"
            wires = self._wires[direction] = _Wires(receiver, direction, side)
        return wires

    # ---- events -------------------------------------------------------------------------------------------

    def receive(
        self, data: bytes, now: int, faults: Iterable[CharacterFault] = (), direction: Direction = "in"
    ) -> None:
        """Handle received bytes; the last of them came at `now`."""
        wires = self._wire(direction)
        scope = self.scope
        began = max(scope.now, now - scope.line.chars(len(data)))
        if self._has_exact_times and self.deadline <= began:
            self.tick(began)
        scope.now = max(scope.now, now)
        wires.receiver.append(data, now, faults)
        self._take(wires)

    def other_sender(self, now: int) -> None:
        """Note that the following bytes come from another sender; unfinished frames become noise."""
        self.scope.now = max(self.scope.now, now)
        for wires in self._wires.values():
            self._flush(wires)

    def line_break(self, now: int, direction: Direction = "in") -> None:
        """Handle a break state of the line: it ends the frames, and those that show their own end are good."""
        self.scope.now = max(self.scope.now, now)
        for wires in self._wires.values():
            wires.receiver.broke(now)
            self._take_last(wires)
        self._show("break", now, direction)

    def tick(self, now: int) -> None:
        """Handle the silence until `now`."""
        while (due := self.deadline) <= now:
            self.scope.now = max(self.scope.now, due)
            for wires in list(self._wires.values()):
                if wires.cut_at <= due:
                    wires.receiver.cut()
                wires.receiver.tick(due)
                self._take(wires)
        self.scope.now = max(self.scope.now, now)

    def ended(self, now: int) -> None:
        """Handle the end of the input: report the remaining bytes."""
        self.tick(now)
        for wires in self._wires.values():
            wires.receiver.cut()
            wires.receiver.tick(now)
            self._take_last(wires)

    def _take_last(self, wires: _Wires) -> None:
        """Report the frames that have ended, and then the remaining bytes."""
        self._take(wires)
        self._flush(wires)

    @property
    def deadline(self) -> int:
        """Return when to call `tick` if no bytes come."""
        due = NEVER
        for wires in self._wires.values():
            due = min(due, wires.receiver.deadline, wires.cut_at)
        return due

    # ---- results ------------------------------------------------------------------------------------------

    def _take(self, wires: _Wires) -> None:
        receiver = wires.receiver
        if wires.side is not None and not self._announcing:
            for arrival in receiver.arrivals(*self._frames[wires.side]):
                self._found(arrival, wires)
            if receiver.broken:
                self._flush(wires)
        else:
            while (found := receiver.next(*self._frames[wires.side or self._next_side])) is not None:
                self._found(found, wires)
                if receiver.broken:
                    self._flush(wires)
        waits = bool(receiver.waiting) and receiver.deadline == NEVER
        wires.cut_at = receiver.stream.last + LONGEST_PAUSE if waits else NEVER

    def _found(self, found: Arrival, wires: _Wires) -> None:
        at = found.ended_at
        if isinstance(found, FrameArrived):
            self.counters.received += 1
            value = found.value
            side = self.table.infos[value.frame].frame.side
            if side != "both":
                self._next_side = "server" if side == "client" else "client"
            reason = "" if value.refusal is None else f"refused with {code_text(value.refusal)}"
            self._announce(value)
            self.monitor(
                Seen(
                    wires.direction, "frame", at, found.raw, value.frame, value.fields, reason,
                    started_at=found.started_at,
                )
            )  # fmt: skip
        elif isinstance(found, BadFrame):
            wires.reported.bad(found)
            self.counters.bad += 1
            self.monitor(
                Seen(
                    wires.direction, "bad", at, found.raw, found.frame, {}, found.cause,
                    started_at=found.started_at, segment=found.segment, place=found.place,
                )
            )  # fmt: skip
        elif count := wires.reported.new_bytes(found):
            self.counters.noise_bytes += count
            reason = "what a bad frame left" if found.skipped else ""
            left = found.data[-count:]
            self.monitor(Seen(wires.direction, "noise", at, left, reason=reason, started_at=found.started_at))

    def _announce(self, value: FrameValue) -> None:
        info = self.table.infos[value.frame]
        if not info.announces:
            return
        try:
            announce(info.announces, value, self.scope)
        except EVALUATION_ERRORS as error:
            self._trouble(value.frame, error)

    def _flush(self, wires: _Wires) -> None:
        for noise in wires.receiver.reset():
            self._found(noise, wires)
        wires.cut_at = NEVER

    def _show(self, kind: Kind, at: int, direction: Direction) -> None:
        self.monitor(Seen(direction, kind, at))

    def _trouble(self, frame: str, error: Exception) -> None:
        self.monitor(Seen("", "trouble", self.scope.now, frame=frame, reason=explain(error)))
