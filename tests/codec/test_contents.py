"""`shows:` of bytes: displays decode them by the layout that a number of the frame selects; exchanges do not."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.api.check import check_file
from framekit.api.monitor import FrameLog
from framekit.codec.codec import compile_protocol
from framekit.codec.contents import Requests, contents_of
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError
from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

TEXT = """protocol: shown
layouts:
  pair: [{field: a, type: u8}, {field: b, type: u8, values: {1: low}}]
  list: [{count: n, type: u8, of: items}, {repeat: items, times: n, of: [{include: pair}]}]
frames:
  f: {body: [{field: kind, type: u8}, {data: d, size: rest, shows: {kind: {1: pair, 2: list}}}]}
"""


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ("01 05 01", {"pair": {"a": 5, "b": 1}}),
        ("02 02 05 01 06 02", {"list": {"n": 2, "items": [{"a": 5, "b": 1}, {"a": 6, "b": 2}]}}),
        ("03 05 01", {}),  # no layout of this number
        ("01 05", {}),  # too short
        ("01 05 01 00", {}),  # too long
        ("02 03 05 01 06 02", {}),
    ],
)
def test_bytes_are_shown_as_their_layout(data: str, expected: dict[str, object]) -> None:
    protocol = load_protocol_text(TEXT)
    fields = compile_protocol(protocol).decode("f", bytes.fromhex(data))
    assert fields == {"kind": int(data[:2]), "d": bytes.fromhex(data[3:])}, "the values of the codec are bytes"
    plain = contents_of(protocol).to_plain("f", fields)
    assert plain == {"kind": fields["kind"], "d": data[3:]} | expected


def test_numbers_in_it_have_names() -> None:
    protocol = load_protocol_text(TEXT)
    contents = contents_of(protocol)
    fields = compile_protocol(protocol).decode("f", bytes.fromhex("02 01 05 01"))
    assert contents.with_names("f", fields)["list"] == {"n": 1, "items": [{"a": 5, "b": "1 (low)"}]}
    found = dict(contents.rows("f", fields))
    assert found == {"list.n": 1, "list.items[0].a": 5, "list.items[0].b": "1 (low)"}
    assert contents_of(protocol) is contents


@pytest.mark.parametrize(
    ("shows", "problem"),
    [
        ("{king: {1: pair}}", "'f' has no value 'king'"),
        ("{kind: {1: pear}}", "there is no layout 'pear'"),
        ("{kind: {1: d}}", "'d' is a value of 'f' already"),
        ("{kind: {x: pair}}", "'x' is not a whole number"),
        ("{}", "this is not one expression with layouts"),
    ],
)
def test_wrong_contents_are_problems(tmp_path: Path, shows: str, problem: str) -> None:
    path = tmp_path / "shown.yaml"
    text = TEXT.replace("{kind: {1: pair, 2: list}}", shows).replace("  list:", "  d: [{field: x, type: u8}]\n  list:")
    path.write_text(text, encoding="utf-8")
    found = [problem.what for problem in check_file(path).problems]
    assert any(what.startswith(problem) for what in found), found


PLC = """device: plc
protocol: snp
station: A1
params: {use_break: no}
state:
  plc_faults: {initial: [{slot: 1, group: low CPU battery, action: fatal, year: 90}]}
  io_faults: {initial: [{slot: 3, group: 3, action: 2}]}
"""
RUN = """run: shown
memory: ge-90-30
channels:
  1: {port: "sim:plc.device.yaml", protocol: snp, station: A1, params: {use_break: no}}
blocks:
  0: {call: get_time, channel: 1, once: yes}
  1: {call: plc_faults, channel: 1, when: block 0 done}
  2: {call: io_faults, channel: 1, when: block 1 done}
  3: {call: controller_id, channel: 1, when: block 2 done}
  4: {call: program_names, channel: 1, when: block 3 done}
  5: {call: establish, channel: 1, with: {area_size: 20}, when: block 4 done}
  6: {call: define_datagram, channel: 1, with: {id: 1, points: [{selector: 8, offset: 0, length: 2}]},
      when: block 5 done}
  7: {call: update_datagram, channel: 1, with: {id: 1}, when: block 6 done}
  8: {read: "%R1", count: 20, into: "%R100", when: block 7 done}
"""


def test_monitors_show_the_data_messages_of_snp(tmp_path: Path) -> None:
    (tmp_path / "plc.device.yaml").write_text(PLC, encoding="utf-8")
    path = tmp_path / "shown.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    clock, seen = VirtualClock(), []
    run = load_run(path)
    service = RunService(run, clock, monitor=lambda channel, one: seen.append(one))
    service.start()
    clock.run_for(5_000_000_000)
    assert all(block.done for block in service.status())
    contents = contents_of(run.channels[1].protocol)
    messages = [event for event in seen if event.frame == "data_message"]
    shown = [list(contents.with_names("data_message", message.fields))[5:] for message in messages]
    assert shown == [
        ["time_date"], ["plc_fault_table"], ["io_fault_table"], ["controller"], ["name_list"], ["datagram_definition"],
        ["datagram_values"], [],
    ]  # fmt: skip
    faults = contents.with_names("data_message", messages[1].fields)["plc_fault_table"]["faults"]
    assert faults[0]["group"] == "18 (low CPU battery)"


def test_monitors_show_the_text_beside_mailboxes_of_srtp(tmp_path: Path) -> None:
    device = PLC.replace("protocol: snp\nstation: A1\nparams: {use_break: no}", "protocol: srtp")
    (tmp_path / "plc.device.yaml").write_text(device, encoding="utf-8")
    path = tmp_path / "shown.run.yaml"
    channel = "protocol: snp, station: A1, params: {use_break: no}"
    path.write_text(RUN.replace(channel, "protocol: srtp, params: {allow: everything}"), encoding="utf-8")
    clock = VirtualClock()
    run = load_run(path)
    protocol = run.channels[1].protocol
    log = FrameLog({1: protocol})
    service = RunService(run, clock, monitor=log.add)
    service.start()
    clock.run_for(5_000_000_000)
    assert all(block.done for block in service.status())
    contents = contents_of(protocol)
    seen = [entry.seen for entry in log.since(0) if entry.seen.frame == "reply_pdu" and entry.seen.fields.get("text")]
    shown = [
        [*contents.to_plain(event.frame, event.fields, event.request).keys() - event.fields.keys()] for event in seen
    ]
    assert shown == [
        ["time_date"], ["plc_fault_table"], ["io_fault_table"], ["controller"], ["name_list"], ["datagram_values"], [],
    ]  # fmt: skip
    names = contents.names("reply_pdu", seen[1].fields, seen[1].request)
    assert names["plc_fault_table.faults[0].group"] == "low CPU battery"
    assert not {*contents.to_plain("reply_pdu", seen[1].fields)} - {*seen[1].fields}  # without the request: bytes


ASKED = """protocol: answered
layouts:
  clock: [{field: hour, type: u8}, {field: minute, type: u8}]
  alarm: [{field: place, type: u8}, {field: kind, type: u8, values: {1: low, 2: high}}]
groups: {order: {}}
frames:
  clock_order: {group: order, body: [{const: 01}, {value: what, read: 1}]}
  alarm_order: {group: order, body: [{const: 02}, {value: what, read: 2}]}
  ask:  {from: client, body: [{const: 05}, {field: n, type: u8}, {inner: order, of: order}]}
  tell:
    from: server
    echo: {n: request.n + 1}
    body: [{const: 02}, {field: n, type: u8}, {data: d, size: 2, shows: {request.order.what: {1: clock, 2: alarm}}}]
"""


def test_a_display_finds_the_request_by_the_values_that_a_frame_echoes() -> None:
    protocol = load_protocol_text(ASKED)
    contents, requests = contents_of(protocol), Requests()

    def heard(frame: str, fields: dict[str, object], client: str = "", channel: int = 1) -> Seen:
        seen = Seen("in", "frame", 0, b"", frame, fields)
        seen.client = client
        requests.attach(contents, seen, channel)
        return seen

    def shown(seen: Seen) -> set[str]:
        return {*contents.to_plain(seen.frame, seen.fields, seen.request)} - {*seen.fields}

    heard("ask", {"n": 4, "order": {"alarm_order": {"what": 2}}})
    heard("ask", {"n": 5, "order": {"clock_order": {"what": 1}}})
    heard("ask", {"n": 5, "order": {"alarm_order": {"what": 2}}}, channel=2)
    assert shown(heard("tell", {"n": 5, "d": b"\x05\x01"})) == {"alarm"}
    assert shown(heard("tell", {"n": 6, "d": b"\x05\x01"})) == {"clock"}
    assert shown(heard("tell", {"n": 6, "d": b"\x05\x01"}, channel=2)) == {"alarm"}
    assert shown(heard("tell", {"n": 9, "d": b"\x05\x01"})) == set()
    assert shown(heard("tell", {"n": 6, "d": b"\x05\x01"}, client="other")) == set()


def test_only_values_of_the_frame_and_its_request_choose_a_layout() -> None:
    with pytest.raises(DefinitionError, match="'tell' has no value 'reply'"):
        load_protocol_text(ASKED.replace("request.order.what", "reply.what"))
