"""A small protocol to be changed here and there, and two clients that read by it: one with the short way, one without.

Both get the same replies and have to tell the same; what the short way has learned can be looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from link.service_loop import codec_of

from framekit.definition.times import NEVER
from framekit.link.client import Client
from framekit.link.direct import DirectRequest
from framekit.link.engine import Engine
from framekit.link.events import Send
from framekit.link.same_reply import SameReply
from framekit.link.transfer import TransferResult

ASKED = (
    "{field: tag, type: u16}, {field: station, type: u8}, {length: n, type: u8, of: [pdu]}, "
    "{inner: pdu, of: asked, size: n}"
)
TOLD = ASKED.replace("asked", "told")
VALUES = "{data: values, size: rest}"
HANDED_OVER = "set: {result: it.pdu}"

READS = """protocol: made_up
station: {type: number, range: 0..255}
line: {kind: stream, tcp: 1}
order: big
params: {reply_timeout: {type: time, default: 1 s}}
state: {number: {type: u16}}
groups:
  asked: {from: client}
  told:  {from: server, echo: [function]}
frames:
  ask:        {from: client, body: [ASKED]}
  answer:     {from: server, echo: [tag, station], body: [TOLD]}
  read:
    group: asked
    body: [{field: function, type: u8, is: 3}, {field: address, type: u8}, {field: count, type: u8}]
  no:         {group: told, body: [{field: function, type: u8, is: 0x83}, {field: code, type: u8}]}
  read_reply: {group: told, body: [{field: function, type: u8, is: 3}, VALUES]}
areas: {words: {unit: word, size: 100, access: rw}}
addresses: [{form: "D{start:dec}", area: words}]
errors: {frame: no, code: code}
services:
  read:
    - areas: [words]
      request: {read: {address: start, count: count}}
      reply: {read_reply: {values: data}}
      packing: {order: big}
sequences:
  exchange:
    takes: [request]
    gives: {reply: result}
    local: {result: frame}
    steps:
      - step: ask
        set: {number: number + 1}
        send: {ask: {tag: number, station: station, pdu: request}}
        receive:
          - {frame: answer, when: "it.pdu.frame in expected", HANDED_OVER, then: end}
        within: reply_timeout
        on_timeout: {fail: no_reply}
roles:
  client: {lanes: {main: {exchange: exchange}}}
"""
for _word, _meaning in (("ASKED", ASKED), ("TOLD", TOLD), ("VALUES", VALUES), ("HANDED_OVER", HANDED_OVER)):
    READS = READS.replace(_word, _meaning)

Reply = Callable[[bytes], bytes]
"""What a device says to a request."""


def changed(*changes: tuple[str, str], text: str = READS) -> str:
    """The protocol with other words in some places, each of which is there once."""
    for old, new in changes:
        assert text.count(old) == 1, f"{text.count(old)} times: {old}"
        text = text.replace(old, new)
    return text


FLAT = changed(
    ("  told:  {from: server, echo: [function]}\n", ""),
    (f"  answer:     {{from: server, echo: [tag, station], body: [{TOLD}]}}\n", ""),
    ("  no:         {group: told, body: [{field: function, type: u8, is: 0x83}, {field: code, type: u8}]}\n", ""),
    ("errors: {frame: no, code: code}\n", ""),
    (
        "{group: told, body: [{field: function, type: u8, is: 3}, {data",
        "{from: server, echo: [tag, station], body: [{data",
    ),
    (
        VALUES,
        "{field: tag, type: u16}, {field: station, type: u8}, {length: n, type: u8, of: [values]}, "
        "{data: values, size: n}",
    ),
    ('{frame: answer, when: "it.pdu.frame in expected"', "{frame: read_reply"),
    ("it.pdu", "it"),
)
"""The same without a frame in a frame: the data stand beside the number that is another one every time."""


def with_values(values: bytes = b"\0\1\0\2") -> Reply:
    """The usual reply, with these data."""
    return lambda asked: asked[:3] + bytes([1 + len(values)]) + b"\3" + values


class LongWay(Engine):
    """An engine without the short way."""

    def direct_request(self, exchange: Any) -> None:
        return None


class Reader:
    """A client that reads two words again and again."""

    def __init__(self, text: str, engine: type[Engine]) -> None:
        protocol, codec = codec_of(text)
        self.engine = engine(protocol, codec, "client", own=1)
        self.client = Client(protocol, codec, self.engine)
        self.results: list[TransferResult] = []
        self.now = 0
        self.engine.opened(0)

    def ask(self) -> bytes:
        """The next request."""
        self.now += 1000
        commands = self.client.read("D1", station=1, count=2, now=self.now, on_done=self.results.append)
        self.engine.sent(self.now)
        return b"".join(command.data for command in commands if isinstance(command, Send))

    def answer(self, data: bytes) -> None:
        """What came; a read that waits for more finds that nothing comes."""
        self.now += 1000
        self.engine.receive(data, self.now)
        if self.engine.deadline < NEVER:
            self.now = max(self.now, self.engine.deadline)
            self.engine.tick(self.now)

    def told(self) -> list[tuple[Any, ...]]:
        return [
            (one.ok, one.values, one.data, one.outcome, one.code, one.raw, repr(one.reply), one.reply and one.reply.raw)
            for one in self.results
        ]


class Pair:
    """Both clients, and what the one with the short way has learned."""

    def __init__(self, text: str = READS) -> None:
        self.short, self.long = Reader(text, Engine), Reader(text, LongWay)

    def read(self, *replies: Reply) -> list[bool]:
        """Reads once for each of these replies; how each ended, by both ways."""
        for reply in replies:
            asked = self.short.ask()
            assert asked == self.long.ask(), "both ask alike"
            for side in (self.short, self.long):
                side.answer(reply(asked))
            assert self.short.told()[-1] == self.long.told()[-1]
        assert len(self.short.results) == len(self.long.results)
        return [one.ok for one in self.short.results[-len(replies) :]]

    @property
    def request(self) -> DirectRequest | None:
        kept = list(self.short.client._ready._kept.values())
        return kept[0].direct if kept else None

    @property
    def same(self) -> SameReply | None:
        return None if self.request is None else self.request.same
