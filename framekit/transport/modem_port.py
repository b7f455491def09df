"""A modem between this port and the line: it is set up, answers calls, and the port is open while somebody is there.

Commands are those of Hayes-compatible modems (ITU-T V.250). It never dials. What is sent once the connection is there
is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from framekit.definition.line_settings import Modem
from framekit.link.events import CharacterFault
from framekit.transport.clock import Clock, Handle
from framekit.transport.passing_port import PassingPort
from framekit.transport.port import Port

TRIES = 3
LONGEST_LINE = 256
HUNG_UP = "the caller has hung up"


class ModemPort(PassingPort):
    """A port that opens when the modem is connected, and closes when the connection ends."""

    def __init__(self, inner: Port, modem: Modem, clock: Clock) -> None:
        super().__init__(inner)
        self.modem = modem
        self.clock = clock
        self.connected = False
        self._text = b""
        self._commands: list[str] = []
        self._tries = 0
        self._rings = 0
        self._timer: Handle | None = None

    def forget(self) -> None:
        super().forget()
        self.connected = False
        self._text = b""
        self._stop_timer()

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    # ---- setting up ---------------------------------------------------------------------------------------

    def opened(self, now: int) -> None:
        self._commands = [command.strip() for command in self.modem.init.split(";") if command.strip()]
        self._rings = self._tries = 0
        self._next_command(now)

    def _next_command(self, now: int) -> None:
        self._stop_timer()
        if self._commands:
            self._tries += 1
            self.inner.write(self._commands[0].encode("ascii", "replace") + b"\r")
            self._timer = self.clock.call_at(now + self.modem.reply_within, self._no_answer)
        elif self.modem.answer is None:
            self._connect(now)

    def _no_answer(self) -> None:
        if self._tries < TRIES:
            self._next_command(self.clock.now())
        else:
            self._give_up("the modem does not answer")

    def _give_up(self, reason: str) -> None:
        self.inner.close()
        super().closed(self.clock.now(), f"{self.name}: {reason}")

    def _connect(self, now: int) -> None:
        self._stop_timer()
        self.connected = True
        super().opened(now)

    # ---- what comes ---------------------------------------------------------------------------------------

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        if self.connected:
            self._data(data, now, faults)
            return
        self._text = (self._text + data)[-LONGEST_LINE:]
        while not self.connected and self.events is not None:
            line, end, rest = self._text.partition(b"\n") if b"\n" in self._text else self._text.partition(b"\r")
            if not end:
                return
            self._text = rest
            self._line(line.strip().decode("ascii", "replace"), now)
        rest, self._text = self._text.lstrip(b"\r\n"), b""
        if rest and self.connected:
            super().received(rest, now)

    def _line(self, line: str, now: int) -> None:
        """A result code of the modem, or the echo of a command."""
        if line == "OK" and self._commands:
            self._commands.pop(0)
            self._tries = 0
            self._next_command(now)
        elif line.startswith("ERROR") and self._commands:
            self._give_up(f"the modem refuses '{self._commands[0]}'")
        elif line.startswith("CONNECT"):
            self._connect(now)
        elif line == "RING" and self.modem.answer:
            self._rings += 1
            if self._rings >= self.modem.answer:
                self._rings = 0
                self.inner.write(b"ATA\r")
        elif line in ("NO CARRIER", "BUSY", "NO ANSWER"):
            self._rings = 0

    def _data(self, data: bytes, now: int, faults: tuple[CharacterFault, ...]) -> None:
        """Data of the connection; the words with which a modem ends it, alone, are its own."""
        if self.modem.answer is not None and data.strip() == b"NO CARRIER":
            self._hang_up()
        else:
            super().received(data, now, faults)

    def _hang_up(self) -> None:
        self.clock.call_soon(partial(self._give_up, HUNG_UP))

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        if self.connected and self.modem.answer is not None and lines.get("dcd") is False:
            self._hang_up()
        else:
            super().control(lines, now)

    # ---- out ----------------------------------------------------------------------------------------------

    def sent(self, now: int) -> None:
        if self.connected:
            super().sent(now)

    def write(self, data: bytes) -> None:
        if self.connected:
            super().write(data)

    def send_break(self, duration: int) -> None:
        if self.connected:
            super().send_break(duration)
