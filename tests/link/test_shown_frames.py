"""What a monitor is shown of frames that are sent: their fields as they were then, whenever it asks for them."""

from __future__ import annotations

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol_text
from framekit.link.engine import Engine
from framekit.link.events import Seen
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


def test_fields_of_a_sent_frame_are_those_of_the_moment_it_was_sent() -> None:
    protocol = load_protocol_text(TEXT, "shown")
    seen: list[Seen] = []
    engine = Engine(protocol, compile_protocol(protocol), None, monitor=seen.append)
    engine.opened(0)
    for frame in ("told", "counted"):
        engine.send_frame(frame, 0, {"what": 5})
        engine.sent(0)
    engine.scope.set("wide", 0)
    engine.scope.set("count", 0)
    sent = [one for one in seen if one.kind == "frame"]
    assert [one.raw for one in sent] == [bytes([2, 5, 6]), bytes([3, 5, 6])]
    assert [one.fields for one in sent] == [{"what": 5, "more": 6}] * 2
    assert [one.fields for one in sent] == [{"what": 5, "more": 6}] * 2, "asked again"


def test_only_a_frame_that_depends_on_no_state_is_read_when_it_is_looked_at() -> None:
    protocol = load_protocol_text(TEXT, "shown")
    engine = Engine(protocol, compile_protocol(protocol), None)
    assert engine.machine.shown_later == {"told": ("wide",)}


def test_lists_that_the_program_changes_later_are_shown_as_they_were() -> None:
    protocol = load_protocol_text(
        "protocol: listed\nline: {kind: stream, tcp: 1}\nframes:\n  f:\n"
        "    body: [{const: 7E}, {repeat: xs, times: 2, of: u8}]\n",
        "listed",
    )
    seen: list[Seen] = []

    def changes(value: FrameValue) -> None:
        value.fields["xs"].append(99)
        value.fields["new"] = 1

    engine = Engine(protocol, compile_protocol(protocol), None, monitor=seen.append, on_frame=changes)
    engine.opened(0)
    values = [1, 2]
    engine.send_frame("f", 0, {"xs": values})
    values[0] = 77
    engine.sent(0)
    engine.receive(bytes.fromhex("7E 03 04"), 0)
    shown = [(one.direction, one.fields) for one in seen if one.kind == "frame"]
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
