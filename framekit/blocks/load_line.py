"""Reads how a channel's port is wired: kind of interface, duplex, direction, echo, flow control, times, modem.

What cannot be together is said here. What speed and format mean is read with the channel.
"""

from __future__ import annotations

from framekit.definition.line_settings import FAST, SPEEDS, Direction, LineSettings, Modem
from framekit.definition.load.reader import Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Mapping, Node
from framekit.definition.times import NEVER, LineFormat
from framekit.transport.schemes import scheme_of

WIRES = ("type", "duplex", "direction", "echo", "handshake")
"""Keys that make sense only where there are wires."""


LONGEST_KEY = 1_000_000_000


class LineLoader:
    """Reads the settings of one channel. Problems go to the reader."""

    def __init__(self, reader: Reader, keys: Mapping, protocol: Protocol, port: str, line: LineFormat | None) -> None:
        self.reader = reader
        self.keys = keys
        self.protocol = protocol
        self.port = port
        self.line = line

    def settings(self) -> LineSettings:
        """The settings; a setting that is wrong is noted and left out."""
        reader, keys = self.reader, self.keys
        self._without_wires()
        kind = self._word("type")
        direction = modem = connect = reconnect = None
        echo = False
        with reader.going_on():
            direction = self._direction(keys.get("direction"))
        with reader.going_on():
            modem = self._modem(keys.get("modem"))
        with reader.going_on():
            echo = reader.flag(keys.get("echo"))
        with reader.going_on():
            connect = self._time("connect_timeout", keys.get("connect_timeout"))
        with reader.going_on():
            reconnect = self._time("reconnect", keys.get("reconnect"))
        settings = LineSettings(
            type=kind,  # type: ignore[arg-type]  # the schema knows them
            half_duplex=(self._word("duplex") or ("half" if kind == "rs485" else "full")) == "half",
            echo=echo,
            direction=direction,
            handshake=self._word("handshake") or "none",  # type: ignore[arg-type]
            connect_within=connect,
            reconnect=reconnect,
            modem=modem,
        )
        self._together(settings)
        self._format(settings)
        return settings

    # ---- single keys --------------------------------------------------------------------------------------

    def _word(self, key: str) -> str | None:
        node = self.keys.get(key)
        return None if node is None else self.reader.text(node)

    def _time(self, key: str, node: Node | None) -> int | None:
        if node is None:
            return None
        time = self.reader.time(node)
        if not 0 < time < NEVER:
            raise self.reader.broken(node.at, f"'{self.reader.text(node)}' is no {key}", "give a time such as 500 ms")
        return time

    def _direction(self, node: Node | None) -> Direction | None:
        """`none`, `rts`, `driver`, or `{by, level, before, after}`. Raises Broken."""
        if node is None:
            return None
        if not isinstance(node, Mapping):
            by = self.reader.text(node)
            return None if by == "none" else Direction(by=by)  # type: ignore[arg-type]  # the schema knows them
        times = {}
        for key in ("before", "after"):
            part = node.get(key)
            times[key] = 0 if part is None else self._line_time(part)
        level = node.get("level")
        by = self.reader.text(node.get("by"))
        high = level is None or self.reader.text(level) == "high"
        return Direction(by=by, high=high, **times)  # type: ignore[arg-type]

    def _line_time(self, node: Node) -> int:
        """A time, also in characters or bits of the line."""
        text = self.reader.text(node).strip()
        for unit, length in (("chars", 0), ("char", 0), ("bits", 1), ("bit", 1)):
            number = text.removesuffix(unit).strip()
            if text.endswith(unit) and number.replace(".", "", 1).isdigit() and self.line is not None:
                return round(float(number) * (self.line.bit_time if length else self.line.character_time))
        time = self.reader.time(node)
        if time > LONGEST_KEY:
            raise self.reader.broken(node.at, f"{text} is too long to hold a line", "give 1 s or less")
        return time

    def _modem(self, node: Node | None) -> Modem | None:
        """`none`, or `{type, init, answer, within}`. Raises Broken."""
        if node is None:
            return None
        if not isinstance(node, Mapping):
            return None
        usual = Modem()
        init, answer, within = node.get("init"), node.get("answer"), node.get("within")
        dedicated = self.reader.text(node.get("type")) == "dedicated"
        if dedicated and answer is not None:
            self.reader.note(answer.at, "nobody calls on a dedicated line", "leave answer out")
        rings = 1 if answer is None else self.reader.number(answer)
        if not 1 <= rings <= 255 and answer is not None:
            raise self.reader.broken(answer.at, f"a modem cannot answer at ring {rings}", "give 1 to 255")
        text = usual.init if init is None else self.reader.text(init)
        if init is not None and not (text.isascii() and text.isprintable()):
            raise self.reader.broken(init.at, "a modem command is printable ASCII", "write it like ATZ;ATE0")
        wait = usual.reply_within if within is None else self._time("within", within)
        return Modem(init=text, answer=None if dedicated else rings, reply_within=wait or usual.reply_within)

    # ---- what cannot be together --------------------------------------------------------------------------

    def _note(self, key: str, what: str, todo: str) -> None:
        node = self.keys.get(key)
        self.reader.note(self.keys.at if node is None else node.at, what, todo)

    def _without_wires(self) -> None:
        stream = self.protocol.line.kind == "stream" and not self.port.startswith("sim:")
        kind = scheme_of(self.port)
        if not stream and (kind is None or kind.wires):
            return
        for key in WIRES:
            if self.keys.get(key) is not None:
                self._note(key, f"'{key}' is about wires, and '{self.port}' has none", "leave it out")

    def _together(self, settings: LineSettings) -> None:
        kind = settings.type
        if kind in ("rs232", "rs422") and settings.half_duplex:
            self._note(
                "duplex", f"{kind} has a pair of wires for each direction", "leave duplex out, or use type: rs485"
            )
        if kind == "rs232" and settings.direction is not None:
            self._note("direction", "an RS-232 port has no transmitter to switch", "leave it out, or use type: rs485")
        if kind in ("rs232", "rs422") and settings.echo:
            self._note("echo", f"{kind} ports do not hear themselves", "leave it out, or use type: rs485")
        if settings.direction is not None and settings.direction.by == "rts" and settings.handshake == "rtscts":
            self._note("handshake", "RTS switches the direction here", "use handshake: none, or direction: driver")
        if kind in ("rs422", "rs485") and settings.handshake == "rtscts":
            self._note("handshake", f"{kind} has no RTS and CTS wires", "leave it out")
        if settings.modem is not None and kind in ("rs422", "rs485"):
            self._note("modem", f"a modem is on an RS-232 port, not on {kind}", "leave it out, or use type: rs232")
        if settings.modem is not None and self.port.startswith("sim:"):
            self._note("modem", "a simulated line has no modem", "leave it out")

    def _format(self, settings: LineSettings) -> None:
        """The speeds and formats that interfaces have: Snet module guide, Table 14, and what is faster today."""
        line = self.line
        if settings.type is None or line is None:
            return
        known = SPEEDS if settings.type == "rs232" else SPEEDS + FAST
        if line.speed not in known:
            near = ", ".join(map(str, sorted(sorted(known, key=lambda speed: abs(speed - line.speed))[:3])))
            self._note("speed", f"{settings.type} ports have no speed of {line.speed}", f"the nearest are {near}")
        if line.data_bits not in (7, 8) or line.parity not in "NEO" or line.stop_bits not in (1, 2):
            what = f"{settings.type} ports have no format {line.data_bits}{line.parity}{line.stop_bits:g}"
            self._note("format", what, "7 or 8 data bits, parity N, E or O, 1 or 2 stop bits")
