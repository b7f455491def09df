"""Monitor events of transmitted frames hold the fields as transmitted, whenever the monitor reads them."""

from __future__ import annotations

import pytest

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol_text
from framekit.link.engine import Engine
from framekit.link.events import Monitor, Seen, Tape, seen_of
from framekit.link.frame_table import table_of
from framekit.link.scope import Scope
from framekit.link.values import FrameValue

TEXT = """protocol: shown
line: {kind: stream, tcp: 1}
params: {wide: {type: number, default: 1}}
state: {count: {type: u8, initial: 1}}
frames:
  told:
    body: [{const: 02}, {field: what, type: u8}, {field: more, type: u8, when: "wide == 1", build: "what + 1"}]
  counted:
    body: [{const: 03}, {field: what, type: u8}, {field: more, type: u8, when: "count == 1", build: "what + 1"}]
"""


class Shown:
    """A monitor that receives events at once, or as the records of a tape."""

    def __init__(self, as_records: bool) -> None:
        self._seen: list[Seen] = []
        self.begun = 0
        self.tape = Tape(self._begins)
        self.monitor: Monitor = self.tape.of("mark") if as_records else self._seen.append

    def _begins(self) -> None:
        self.begun += 1

    @property
    def frames(self) -> list[Seen]:
        assert {record[0] for record in self.tape.records} <= {"mark"}
        seen = self._seen or [seen_of(record) for record in self.tape.records]
        return [event for event in seen if event.kind == "frame"]


WAYS = pytest.mark.parametrize("as_records", [False, True], ids=["at once", "records"])


@WAYS
def test_fields_of_a_sent_frame_are_those_of_the_moment_it_was_sent(as_records: bool) -> None:
    protocol = load_protocol_text(TEXT, "shown")
    shown = Shown(as_records)
    engine = Engine(protocol, compile_protocol(protocol), None, monitor=shown.monitor)
    engine.opened(0)
    for frame in ("told", "counted"):
        engine.send_frame(frame, 0, {"what": 5})
        engine.sent(0)
    engine.scope.set("wide", 0)
    engine.scope.set("count", 0)
    sent = shown.frames
    assert [event.raw for event in sent] == [bytes([2, 5, 6]), bytes([3, 5, 6])]
    assert [event.fields for event in sent] == [{"what": 5, "more": 6}] * 2
    assert [event.fields for event in sent] == [{"what": 5, "more": 6}] * 2, "asked again"


@WAYS
def test_names_of_a_frame_are_kept_until_a_parameter_is_set(as_records: bool) -> None:
    protocol = load_protocol_text(TEXT, "shown")
    shown = Shown(as_records)
    engine = Engine(protocol, compile_protocol(protocol), None, monitor=shown.monitor)
    engine.opened(0)
    back = None
    for number in range(6):
        if number == 2:
            engine.scope.set("wide", 0)
        elif number == 3:
            back = engine.scope.override({"wide": 1})
        elif number == 4 and back is not None:
            back()
        engine.send_frame("told", 10 * number, {"what": number})
        engine.sent(10 * number)
    wide, narrow = "more", "what"
    found = [(frame.at, list(frame.fields)[-1]) for frame in shown.frames]
    assert found == [(0, wide), (10, wide), (20, narrow), (30, wide), (40, narrow), (50, narrow)]


def test_a_tape_asks_for_its_reader_once_until_it_is_read() -> None:
    protocol = load_protocol_text(TEXT, "shown")
    shown = Shown(True)
    engine = Engine(protocol, compile_protocol(protocol), None, monitor=shown.monitor)
    engine.opened(0)
    begun = shown.begun
    assert [seen_of(record).kind for record in shown.tape.take()] == ["open"] and begun == 1
    for number in (1, 2):
        engine.send_frame("told", number, {"what": 1})
        engine.sent(number)
        engine.receive(bytes([2, 1, 2]), number)
    assert shown.begun == 2
    assert [(frame.direction, frame.at, frame.raw) for frame in shown.frames] == [
        ("out", 1, b"\2\1\2"), ("in", 1, b"\2\1\2"), ("out", 2, b"\2\1\2"), ("in", 2, b"\2\1\2"),
    ]  # fmt: skip
    shown.tape.take()
    engine.receive(b"\x99", 3)
    engine.closed(4, "gone")
    assert shown.begun == 3 and [seen_of(record).kind for record in shown.tape.take()] == ["closed", "noise"]


def test_only_a_frame_that_depends_on_no_state_is_read_when_it_is_looked_at() -> None:
    protocol = load_protocol_text(TEXT, "shown")
    engine = Engine(protocol, compile_protocol(protocol), None)
    assert engine.machine.shown_later == {"told": ("wide",)}


@WAYS
def test_lists_that_the_program_changes_later_are_shown_as_they_were(as_records: bool) -> None:
    protocol = load_protocol_text(
        "protocol: listed\nline: {kind: stream, tcp: 1}\nframes:\n  f:\n"
        "    body: [{const: 7E}, {repeat: xs, times: 2, of: u8}]\n",
        "listed",
    )
    monitor = Shown(as_records)

    def changes(value: FrameValue) -> None:
        value.fields["xs"].append(99)
        value.fields["new"] = 1

    engine = Engine(protocol, compile_protocol(protocol), None, monitor=monitor.monitor, on_frame=changes)
    engine.opened(0)
    values = [1, 2]
    engine.send_frame("f", 0, {"xs": values})
    values[0] = 77
    engine.sent(0)
    engine.receive(bytes.fromhex("7E 03 04"), 0)
    shown = [(frame.direction, frame.fields) for frame in monitor.frames]
    assert shown == [("out", {"xs": [1, 2]}), ("in", {"xs": [3, 4]})]


def test_a_number_that_replies_repeat_is_as_it_was_sent_and_the_frame_is_not_read_for_it() -> None:
    protocol = load_protocol_text(
        "protocol: counted\nline: {kind: stream, tcp: 1}\nstate: {seq: {type: u8, initial: 7}}\nframes:\n"
        "  ask: {body: [{const: 01}, {field: seq, type: u8, plus: 1, build: seq}, {field: n, type: u8}]}\n"
        "  answer: {echo: [seq], body: [{const: 02}, {field: seq, type: u8, plus: 1}]}\n"
        "  around: {body: [{const: 7E}, {inner: one, of: [ask, answer]}]}\n",
        "counted",
    )
    codec = compile_protocol(protocol)
    table, scope = table_of(protocol, codec), Scope(protocol)
    request = FrameValue("ask", {"n": 5})
    assert table.encode(FrameValue("around", {"one": request}), scope) == bytes([0x7E, 1, 8, 5])
    scope.set("seq", 9)
    replies = [
        table.received("around", codec.frames["around"].decode(bytes([0x7E, 2, 8 + n])), None, None) for n in (0, 2)
    ]
    assert [table.repeats(reply, None, request, scope) for reply in replies] == [True, False]
    assert type(request.rest) is tuple, "it has been read"
    assert request.complete() == {"seq": 7, "n": 5}
