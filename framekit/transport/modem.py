"""A modem around a port: it dials, or answers calls, and hangs up. The port is open while the modem is connected.

Commands and results are those of ITU-T V.250 and of the Hayes modems before it: `ATD`, `ATA`, `ATH`, the escape
sequence `+++` between two silences; results as words or as numbers, with or without an echo of the commands.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Literal

from framekit.definition.times import LineFormat, Modem, readable_time
from framekit.link.events import CharacterFault
from framekit.transport.clock import Clock
from framekit.transport.port import PassingPort, Port, PortEvents

log = logging.getLogger(__name__)

TRIES = 3
"""Number of times that a command of `init` is sent."""
LONGEST_LINE = 256
"""Characters of a result line that are kept."""
LONGEST_HANG_UP = 30_000_000_000
"""Longest wait for unsent data before the escape sequence (ns)."""
DTR_OFF = 1_000_000_000
"""Duration of DTR off (ns) before the port closes; modems need up to 0.5 s."""
SETTLING = 1_000_000_000
"""Time after a line `NO CARRIER` among other data (ns) without new data that shows that the modem, not the other side,
sent the line. The modem's echo of written data is not new data.
"""
ECHO = 512
"""Bytes of written data in which an echo is searched; a longer echo is new data."""
SHORT_CONNECTION = 30_000_000_000
"""Duration (ns) below which a connection counts as a failed call."""
LONGEST_ANSWER = 60_000_000_000
"""Longest time from `ATA` to the connection (ns); V.250 has a default of 50 s for the carrier (S7)."""
RING_PAUSE = 10_000_000_000
"""Silence (ns) after which the next `RING` is the first of a new call."""
CROSSING = 1_000_000_000
"""Time after `ATA` (ns) within which a `RING` belongs to the call that is being answered."""
LINE_END = 500_000_000
"""Time for a modem in command mode to discard an unfinished command line (ns)."""

HUNG_UP = "the caller has hung up"
LOST = b"NO CARRIER"
LOST_LINE = b"\r\n" + LOST + b"\r\n"
ERROR_LINE = b"\r\nERROR\r\n"

NUMBERS = {
    "0": "OK", "1": "CONNECT", "2": "RING", "3": "NO CARRIER", "4": "ERROR", "5": "CONNECT", "6": "NO DIALTONE",
    "7": "BUSY", "8": "NO ANSWER", "10": "CONNECT",
}  # fmt: skip
"""Results as numbers: those of V.250, and 5 and 10 of Hayes (CONNECT 1200, CONNECT 2400)."""

NO_REPLY = "the modem does not answer"
UNCLEAR = "the modem answers {result}, which each maker uses differently – add ATV1 to init"
NO_DIAL_TONE = "the telephone line has no dial tone – check its cable; for a private exchange add X3 to init"
BLOCKED = "the modem blocks further calls to this number for a while – make pause and rest longer"
FAILURES = {
    "BUSY": "{number} is engaged",
    "NO CARRIER": "no modem at {number} has taken the call",
    "NO ANSWER": "the call to {number} was not taken",
    "NO DIALTONE": NO_DIAL_TONE,
    "NO DIAL TONE": NO_DIAL_TONE,
    "ERROR": "it refuses {command} – check dial and extension",
    "RING": "a call came in before {number} was dialled",
    "VOICE": "a voice at {number} has taken the call, and no modem",
    "FAX": "a fax machine at {number} has taken the call",
    "DELAYED": BLOCKED,
    "BLACKLISTED": BLOCKED,
}
"""Results that end a call without a connection, with their meanings."""

Phase = Literal["closed", "opening", "calling", "connected", "ending"]
"""`opening`: commands are sent, or a ring is awaited; `calling`: until the connection; `ending`: hanging up."""

Handler = Callable[[str, int], None]
"""Handles a result at a time (ns)."""


class ModemPort(PassingPort):
    """A port that opens when the modem is connected, and closes when the connection ends.

    Closing it hangs up in the background; `when_closed` reports the end.
    """

    def __init__(self, inner: Port, modem: Modem, clock: Clock) -> None:
        super().__init__(inner)
        self.modem = modem
        self.clock = clock
        self._phase: Phase = "closed"
        self._commands: list[str] = []
        """Commands of `init` without a reply yet."""
        self._tries = 0
        self._rings = 0
        """Rings of the present call."""
        self._answered_at = 0
        """Time of the last `ATA` (ns)."""
        self._connected_at = 0
        self._failed_calls = 0
        """Failed calls since the last connection that was not short, or since the last rest."""
        self._rests_until = 0
        self._rest_time = 0
        """Time without calls (ns) after the call that ends; 0: no rest."""
        self._reason = ""
        """Reason to report when the modem has hung up; empty: no report."""
        self._has_escaped = False
        """Whether the modem was hung up because it did not reply to `init`."""
        self._text = bytearray()
        """The unfinished result line."""
        self._skips_feed = False
        """Whether a line feed that comes next belongs to the result CONNECT."""
        self._ending = b""
        """Received data that may be the beginning of `NO CARRIER`."""
        self._tail = b""
        """The last received data, shorter by a byte than `NO CARRIER` with its line ends."""
        self._after_lost = b""
        """Data received after the last `NO CARRIER`, while `SETTLING` is not over."""
        self._written = b""
        """The last data written, `ECHO` bytes at most."""
        self._is_sending = False
        self._hang_up_until = 0
        self._on_result: Handler = self._ignore
        self._on_alarm: Callable[[], None] = self._end
        self._alarm = clock.alarm(self._ring_alarm)
        self._on_closed: list[Callable[[], None]] = []

    def _expect(self, on_result: Handler, on_alarm: Callable[[], None], within: int) -> None:
        """Handle results by `on_result` from now on, and call `on_alarm` after `within` ns unless that changes."""
        self._on_result, self._on_alarm = on_result, on_alarm
        self._alarm.set(self.clock.now() + within)

    def _ring_alarm(self) -> None:
        self._on_alarm()

    def _ignore(self, result: str, now: int) -> None:
        """Ignore a result."""

    def _send(self, command: str) -> None:
        self.inner.write(command.encode("ascii", "replace") + b"\r")

    # ---- opening ------------------------------------------------------------------------------------------

    @property
    def rests_until(self) -> int:
        return self._rests_until

    def open(self, events: PortEvents) -> None:
        if self.events is not None:
            self.close()
        self.events = events
        if self._phase != "ending":
            self._phase = "opening"
            self.inner.open(self)

    def opened(self, now: int) -> None:
        self._commands = [command.strip() for command in self.modem.init.split(";") if command.strip()]
        self._text.clear()
        self._is_sending = False
        self._tries = 0
        self._next_command(now)

    def _next_command(self, now: int) -> None:
        """Send the next command of `init`; after the last one dial, wait for a call, or connect."""
        self._alarm.cancel()
        dialling = self.modem.dialling
        if self._commands:
            self._tries += 1
            self._send(self._commands[0])
            self._expect(self._init_result, self._no_reply, self.modem.reply_within)
        elif dialling is not None:
            self._phase = "calling"
            self._send(dialling.command)
            self._expect(self._call_result, self._cancel_call, dialling.connect_within)
        elif self.modem.answer is not None:
            self._await_call()
        else:
            self._connect(now)

    def _no_reply(self) -> None:
        """Repeat the command. A modem that never replies may hold a connection of an earlier run: hang up once."""
        if self._tries < TRIES:
            self._next_command(self.clock.now())
        elif self.modem.is_switched and not self._has_escaped:
            self._has_escaped = True
            self._hang_up()
        else:
            self._fail(NO_REPLY)

    def _init_result(self, result: str, now: int) -> None:
        if result == "OK":
            self._commands.pop(0)
            self._has_escaped = False
            self._tries = 0
            self._next_command(now)
        elif result == "ERROR":
            self._fail(f"the modem refuses '{self._commands[0]}'")

    def _connect(self, now: int) -> None:
        self._alarm.cancel()
        self._phase = "connected"
        self._connected_at = now
        self._is_sending = False
        self._ending = self._tail = self._written = b""
        super().opened(now)

    def _fail(self, reason: str) -> None:
        """Close the port, and report why."""
        self.inner.close()
        self._report_closed(self.clock.now(), f"{self.name}: {reason}")

    # ---- calls --------------------------------------------------------------------------------------------

    def _await_call(self) -> None:
        self._phase = "opening"
        self._rings = 0
        self._alarm.cancel()
        self._on_result = self._ring_result

    def _ring_result(self, result: str, now: int) -> None:
        if result == "CONNECT":
            self._connect(now)
        elif result == "RING":
            self._rings += 1
            if self._rings >= (self.modem.answer or 1):
                self._phase = "calling"
                self._answered_at = now
                self._send("ATA")
                self._expect(self._answer_result, self._cancel_answer, LONGEST_ANSWER)
            else:
                self._expect(self._ring_result, self._await_call, RING_PAUSE)
        elif result in FAILURES:
            self._await_call()

    def _answer_result(self, result: str, now: int) -> None:
        if result == "CONNECT":
            self._connect(now)
        elif result == "RING":
            if now - self._answered_at >= CROSSING:
                self._await_call()
                self._ring_result(result, now)
        elif result in FAILURES:
            self._await_call()
        elif result.isdigit():
            log.warning("%s: %s", self.name, UNCLEAR.format(result=result))
            self._hang_up()

    def _cancel_answer(self) -> None:
        """Cancel an answer that takes too long, and wait for the next call; without a reply hang up and begin again."""
        log.warning("%s: no connection within %s after ATA", self.name, readable_time(LONGEST_ANSWER))
        self._cancel(self._await_call, self._hang_up)

    def _call_result(self, result: str, now: int) -> None:
        dialling = self.modem.dialling
        assert dialling is not None
        if result == "CONNECT":
            self._connect(now)
        elif result in FAILURES:
            why = FAILURES[result].format(number=dialling.number, command=dialling.command)
            self._call_failed(f"the modem answers {result}: {why}")
        elif result.isdigit():
            self._call_unclear(UNCLEAR.format(result=result))

    def _cancel_call(self) -> None:
        """Cancel a call that takes too long; hang up if the modem does not confirm that."""
        dialling = self.modem.dialling
        assert dialling is not None
        reason = f"no connection with {dialling.number} within {readable_time(dialling.connect_within)}"
        self._cancel(lambda: self._call_failed(reason), lambda: self._call_unclear(reason))

    def _cancel(self, on_cancelled: Callable[[], None], on_silence: Callable[[], None]) -> None:
        """Cancel a call: any character does so (V.250)."""

        def handle(result: str, now: int) -> None:
            if result == "CONNECT":
                self._connect(now)
            elif result == "OK" or result in FAILURES:
                on_cancelled()

        self._send("")
        self._expect(handle, on_silence, self.modem.reply_within)

    def _call_failed(self, reason: str) -> None:
        self._fail(self._counted(reason))

    def _call_unclear(self, reason: str) -> None:
        """Hang up after a call that may be connected, then report the reason."""
        self._reason = f"{self.name}: {self._counted(reason)}"
        self._hang_up()

    def _counted(self, reason: str) -> str:
        """Count the end of a call of this modem, and rest. Return the reason, with the rest after the last retry.

        A connection that was not short begins a new count. Outside of calls there is no effect.
        """
        dialling = self.modem.dialling
        if dialling is None or self._phase not in ("calling", "connected"):
            return reason
        is_short = self._phase == "calling" or self.clock.now() - self._connected_at < SHORT_CONNECTION
        self._failed_calls = self._failed_calls + 1 if is_short else 0
        self._rest_time = dialling.pause
        if self._failed_calls > dialling.retries:
            self._failed_calls = 0
            self._rest_time = dialling.rest
            calls = "the failed call" if dialling.retries == 0 else f"{dialling.retries + 1} failed calls"
            reason += f"; after {calls} framekit waits for {readable_time(dialling.rest)}"
        self._rest()
        return reason

    def _rest(self) -> None:
        """Make no call before `_rest_time` is over."""
        self._rests_until = max(self._rests_until, self.clock.now() + self._rest_time)

    # ---- received data ------------------------------------------------------------------------------------

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        index = 0
        while index < len(data) and self._phase not in ("connected", "closed"):
            byte = data[index]
            index += 1
            if byte not in b"\r\n":
                if len(self._text) < LONGEST_LINE:
                    self._text.append(byte)
                continue
            line = self._text.decode("ascii", "replace").strip()
            self._text.clear()
            self._skips_feed = byte == ord("\r") and not line.isdigit()
            if line:
                self._on_result(_result(line), now)
        if index < len(data) and self._phase == "connected":
            self._data(data[index:], now, _from(faults, index))

    def _data(self, data: bytes, now: int, faults: tuple[CharacterFault, ...]) -> None:
        """Pass on data of the connection, except for the modem's message that the connection has ended."""
        if self._skips_feed:
            self._skips_feed = False
            if data.startswith(b"\n"):
                data, faults = data[1:], _from(faults, 1)
        if not data:
            return
        if self.modem.is_switched:
            text = (self._ending + data).strip(b"\r\n")
            if text == LOST:
                self.clock.call_soon(self._connection_lost)
                return
            self._ending = text if LOST.startswith(text) else b""
            self._look_for_end(data)
        super().received(data, now, faults)

    def _look_for_end(self, data: bytes) -> None:
        """Search the modem's message in data with other bytes; begin to settle after it."""
        joined = self._tail + data
        at = joined.rfind(LOST_LINE)
        if at >= 0:
            self._after_lost = joined[at + len(LOST_LINE) :]
            self._expect(self._ignore, self._settled, SETTLING)
        elif len(self._after_lost) <= ECHO:
            self._after_lost += data
        self._tail = joined[-len(LOST_LINE) + 1 :]

    def _settled(self) -> None:
        """End the connection if after the message only an echo of written data came, or `ERROR`.

        A modem in command mode sends these; a message inside of data has other data after it.
        """
        if _seven_bits(self._after_lost.replace(ERROR_LINE, b"")) in _seven_bits(self._written):
            self._connection_lost()

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        if self.modem.is_switched and lines.get("dcd") is False:
            self.clock.call_soon(self._connection_lost)
        elif self._phase == "connected":
            super().control(lines, now)

    def _connection_lost(self) -> None:
        dialling = self.modem.dialling
        if self._phase == "ending":
            self._end()
        elif self._phase != "connected":
            return
        elif dialling is None:
            self._fail(HUNG_UP)
        else:
            self._call_failed(f"the connection with {dialling.number} is lost")

    # ---- hanging up ---------------------------------------------------------------------------------------

    def close(self) -> None:
        self.forget()
        self._reason = ""
        self._has_escaped = False
        if self._phase == "connected" and self.modem.is_switched:
            self._counted("")
            self._hang_up()
        elif self._phase == "calling":
            self._phase = "ending"
            self._send("")
            self._expect(self._call_ended, self._hang_up, self.modem.reply_within)
        elif self._phase != "ending":
            self._end()

    def _call_ended(self, result: str, now: int) -> None:
        if result == "CONNECT":
            self._hang_up()
        elif result == "OK" or result in FAILURES:
            self._end()

    def _hang_up(self) -> None:
        self._phase = "ending"
        if self.modem.hang_up == "dtr":
            self.inner.set_dtr(False)
            self._expect(self._ignore, self._end, DTR_OFF)
        else:
            self._hang_up_until = self.clock.now() + LONGEST_HANG_UP
            self._expect(self._ended_itself, self._escape, self.modem.guard)

    def _ended_itself(self, result: str, now: int) -> None:
        if result == "NO CARRIER":
            self._end()

    def _escape(self) -> None:
        """Send the escape sequence, if all data was sent before the silence."""
        if self._is_sending and self.clock.now() < self._hang_up_until:
            self._alarm.set(self.clock.now() + self.modem.guard)
            return
        self._text.clear()
        self.inner.write(b"+++")
        self._expect(self._escaped, self._end_line, self.modem.guard + self.modem.reply_within)

    def _escaped(self, result: str, now: int) -> None:
        if result == "OK":
            self._put_down()
        elif result == "NO CARRIER":
            self._end()

    def _end_line(self) -> None:
        """End the line of the escape sequence, which a modem in command mode takes for a command without replying.

        The reply may also have been lost in other data.
        """
        self._send("")
        self._expect(self._ignore, self._put_down, LINE_END)

    def _put_down(self) -> None:
        self._send("ATH")
        self._expect(self._call_ended, self._holds_the_line, self.modem.reply_within)

    def _holds_the_line(self) -> None:
        if self._has_escaped:
            self._fail(NO_REPLY)
        else:
            log.warning("%s: the modem does not confirm that it has hung up: it may still hold the line", self.name)
            self._end()

    def _end(self) -> None:
        """Close the port inside. Report the reason of the end, if there is any, or open the port again if it is used.

        It is used if its opening was requested while the modem hung up, or if `init` begins again.
        """
        self.inner.close()
        if self._reason:
            self._report_closed(self.clock.now(), self._reason)
            return
        self._settle()
        if self.events is not None:
            self._phase = "opening"
            self.inner.open(self)

    def _settle(self) -> None:
        """Forget the call, and report that the port is closed."""
        self._phase = "closed"
        self._alarm.cancel()
        self._on_result = self._ignore
        self._reason = ""
        if self._rest_time:
            self._rest()
            self._rest_time = 0
        waiting, self._on_closed = self._on_closed, []
        for done in waiting:
            done()

    def closed(self, now: int, reason: str) -> None:
        self._report_closed(now, self._reason or self._counted(reason))

    def _report_closed(self, now: int, reason: str) -> None:
        self._has_escaped = False
        self._settle()
        super().closed(now, reason)

    def when_closed(self, done: Callable[[], None]) -> None:
        if self._phase == "ending":
            self._on_closed.append(done)
        else:
            done()

    # ---- data to send -------------------------------------------------------------------------------------

    def sent(self, now: int) -> None:
        self._is_sending = False
        if self._phase == "connected":
            super().sent(now)
        elif self._phase == "ending" and self._on_alarm == self._escape:
            self._alarm.set(now + self.modem.guard)

    def write(self, data: bytes) -> None:
        if self._phase == "connected":
            self._is_sending = True
            self._written = (self._written + data)[-ECHO:]
            super().write(data)

    def write_marked(self, data: bytes, marked: int) -> None:
        self.write(data)

    def send_break(self, duration: int) -> None:
        if self._phase == "connected":
            self._is_sending = True
            super().send_break(duration)

    def change_line(self, line: LineFormat) -> None:
        """Ignore the change: the format between computer and modem stays the same."""


def _result(line: str) -> str:
    """Return the result of a line: a number as its word, CONNECT and ERROR without their details."""
    result = NUMBERS.get(line, line)
    if result.startswith("CONNECT"):
        return "CONNECT"
    return "ERROR" if result.startswith(("ERROR", "+CME ERROR")) else result


def _seven_bits(data: bytes) -> bytes:
    """Return the data with bit 7 cleared: some modems echo seven bits."""
    return bytes(byte & 0x7F for byte in data)


def _from(faults: tuple[CharacterFault, ...], start: int) -> tuple[CharacterFault, ...]:
    """Return the faults of the data from an index on."""
    return tuple(CharacterFault(fault.index - start, fault.fault) for fault in faults if fault.index >= start)
