"""A modem that follows a script, without a port: bytes in, bytes out at the times it asks for.

It knows the commands of V.250 that matter here: `AT…`, `ATD…`, `ATA`, `ATH`, any character against a call under way,
and the escape sequence between two silences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

SECOND = 1_000_000_000

NUMBERS = {
    "OK": "0", "CONNECT": "1", "RING": "2", "NO CARRIER": "3", "ERROR": "4", "NO DIALTONE": "6", "BUSY": "7",
    "NO ANSWER": "8",
}  # fmt: skip


@dataclass
class ScriptedModem:
    """The modem: `write` sends bytes to the computer, `later` calls after a time (ns), `now` gives the time."""

    write: Callable[[bytes], None]
    later: Callable[[int, Callable[[], None]], object]
    now: Callable[[], int]
    calls: list[str] = field(default_factory=list)
    """Results of the calls, in order; an empty text: no result until the computer cancels the call."""
    has_echo: bool = True
    has_words: bool = True
    refused: tuple[str, ...] = ()
    """Commands that it refuses."""
    reports_junk: bool = False
    """Whether it answers lines that are no commands with ERROR."""
    answers_calls: bool = True
    """Whether ATA has a result."""
    is_deaf: bool = False
    takes: int = 2 * SECOND
    """Time from dialling to the result of the call (ns)."""
    guard: int = SECOND
    """Silence that it wants around the escape sequence (ns)."""
    unknown_connections: tuple[str, ...] = ()
    """Results of calls that are connected, in this modem's own words or numbers."""
    answer: Callable[[bytes], bytes] = lambda data: b""
    """The station at the other end: its reply to data of the connection."""

    commands: list[str] = field(default_factory=list)
    """Commands as they came."""
    dialled: list[int] = field(default_factory=list)
    """Times of the dial commands."""
    heard: bytes = b""
    """Data of the connection."""
    is_online: bool = False
    is_calling: bool = False
    _text: bytes = b""
    _call: int = 0
    _last: int = -SECOND

    def feed(self, data: bytes) -> None:
        """Take bytes from the computer."""
        if self.is_deaf:
            return
        if self.is_online:
            self._data(data)
            return
        if self.is_calling:
            self.is_calling = False
            self._call += 1
            self.say("NO CARRIER")
            return
        if self.has_echo and data:
            self.write(data)
        self._text += data
        while b"\r" in self._text:
            line, _, self._text = self._text.partition(b"\r")
            _, prefix, body = line.partition(b"AT")
            if prefix:
                self._command((prefix + body).decode("ascii"))
            elif line and self.reports_junk:
                self.say("ERROR")

    def _command(self, command: str) -> None:
        self.commands.append(command)
        if command in self.refused:
            self.say("ERROR")
        elif command.startswith("ATD"):
            self.dialled.append(self.now())
            self.is_calling = True
            self._call += 1
            call, result = self._call, self.calls.pop(0)
            if result:
                self.later(self.takes, lambda: self._called(call, result))
        elif command == "ATA":
            if self.answers_calls:
                self.connect("CONNECT 9600")
            else:
                self.is_calling = True
        else:
            self.say("OK")

    def _called(self, call: int, result: str) -> None:
        if call != self._call or not self.is_calling:
            return
        self.is_calling = False
        if result.startswith("CONNECT") or result in self.unknown_connections:
            self.connect(result)
        else:
            self.say(result)

    def connect(self, result: str) -> None:
        self.say(result)
        self.is_online = True
        self._last = self.now()

    def _data(self, data: bytes) -> None:
        now = self.now()
        is_quiet = now - self._last >= self.guard
        self._last = now
        if data == b"+++" and is_quiet:
            self.later(self.guard, lambda: self._escaped(now))
            return
        self.heard += data
        if reply := self.answer(data):
            self.write(reply)

    def _escaped(self, since: int) -> None:
        if self._last == since and self.is_online:
            self.is_online = False
            self.say("OK")

    def lose_carrier(self) -> None:
        """End the connection, as the other side does."""
        self.is_online = False
        self.say("NO CARRIER")

    def say(self, result: str) -> None:
        """Send a result."""
        if self.has_words:
            self.write(b"\r\n" + result.encode("ascii") + b"\r\n")
        else:
            word = "CONNECT" if result.startswith("CONNECT") else result
            self.write(NUMBERS.get(word, word).encode("ascii") + b"\r")
