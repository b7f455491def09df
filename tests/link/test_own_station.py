"""The requests that a server of `standard` accepts: the values of their station decide, not the name of a field."""

from __future__ import annotations

import pytest
from link.link_world import SECOND, Side, compiled

from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

OVEN = """\
protocol: oven
extends: standard
station: {type: number, range: 1..99, default: 1}
params: {base: {type: number, default: 0x20}}
tables: {places: {1: 0x11, 2: 0x12}}
groups:
  request: {from: client, head: [{const: STX}, {field: command, type: u8}]}
  reply: {from: server, head: [{const: ACK}]}
frames:
  PEEK: {group: request, where: {command: 0x50}, body: [{field: station, type: u8}, {field: register, type: u8}]}
  READ: {group: request, where: {command: 0x52}, body: [{field: address, type: u8}, {field: register, type: u8}]}
  ASK: {group: request, where: {command: 0x41}, body: [{include: whom, as: to}, {field: register, type: u8}]}
  FIND: {group: request, where: {command: 0x46}, body: [{field: address, type: u8}, {field: register, type: u8}]}
  SUM: {group: request, where: {command: 0x53}, body: [{field: register, type: u8}, {field: unit, type: u8}]}
  VALUE: {group: reply, body: [{length: n, type: u8, of: [values]}, {data: values, size: n}]}
layouts: {whom: [{field: rack, type: u8}, {field: slot, type: u8}]}
areas: {R: {unit: word, size: 100}, S: {unit: word, size: 100}, T: {unit: word, size: 100}, U: {unit: word, size: 100},
  V: {unit: word, size: 100}}
addresses: [{form: "{area}{start:dec}"}]
services:
  read:
    - {areas: [S], request: {PEEK: {station: station, register: start}}, reply: {VALUE: {values: data}},
       limit: {count: 1}, back: {count: 1}}
    - {areas: [R], request: {READ: {address: station + base, register: start}}, reply: {VALUE: {values: data}},
       limit: {count: 1}, back: {count: 1}}
    - {areas: [T], request: {ASK: {to: {rack: 0, slot: "get(places, station, 0)"}, register: start}},
       reply: {VALUE: {values: data}}, limit: {count: 1}, back: {area: "'T'", start: request.register, count: 1}}
    - {areas: [U], request: {FIND: {address: 7, register: start}}, reply: {VALUE: {values: data}},
       limit: {count: 1}, back: {count: 1}}
    - {areas: [V], request: {SUM: {unit: station, register: start}}, reply: {VALUE: {values: data}},
       limit: {count: 1}, back: {count: 1}, client_only: yes}
"""


def answers(text: str, request: str, own: int | None = 2) -> list[bytes]:
    """Return the transmissions of a device with this station after receiving these bytes."""
    protocol, codec = compiled(text)
    side = Side(text, "server", own=own, server=MemoryServer(protocol, codec, DeviceMemory(memory_of(protocol)[0])))
    side.gets(bytes.fromhex(request))
    side.run(SECOND)
    return side.taken()


@pytest.mark.parametrize(
    ("own", "other"),
    [
        ("02 50 02 05", "02 50 01 05"),  # a field called station
        ("02 52 22 05", "02 52 02 05"),  # an expression over the station and a parameter
        ("02 41 00 12 05", "02 41 00 11 05"),  # a field of a record, by a table
        ("02 46 07 05", ""),  # no station: a field of another request's name for something else
    ],
)
def test_a_server_answers_its_own_station_only(own: str, other: str) -> None:
    assert answers(OVEN, own) == [bytes.fromhex("06 02 00 00")]
    assert answers(OVEN, other) == []


def test_frames_that_nothing_builds_share_the_field_of_the_others() -> None:
    more = "  STOP: {group: request, where: {command: 0x5A}, body: [{field: unit, type: u8}]}\n"
    text = OVEN.replace("  VALUE:", more + "  VALUE:")
    text += """  halt: [{request: {STOP: {}}, reply: {VALUE: {values: h'AB'}}, server_only: yes}]
"""
    assert answers(text, "02 5A 02") == [bytes.fromhex("06 01 AB")]
    assert answers(text, "02 5A 01") == []


def test_only_frames_have_a_station() -> None:
    text = """\
protocol: queues
queues: {waiting: {holds: {item: number}, size: 2}}
sequences:
  work:
    steps:
      - {step: idle, receive: [{queue: waiting, station: own, then: again}]}
roles: {server: {lanes: {main: {listen: work}}}}
"""
    with pytest.raises(DefinitionError, match="6:58: only frames have a station – leave station out"):
        load_protocol_text(text)


CHANNELS = """\
protocol: channels
extends: standard
station: {type: none}
params: {device_id: {type: bytes, size: 3, default: 00 00 01}, asker: {type: number, from: client, default: 9}}
groups:
  request: {from: client, head: [{const: STX}, {field: kind, type: u8}, {field: device, type: bytes, size: 3}]}
  reply: {from: server, head: [{const: ACK}, {field: device, type: bytes, size: 3}]}
frames:
  READ: {group: request, where: {kind: 1}, body: [{field: source, type: u8}, {field: register, type: u8}]}
  HELLO: {group: request, where: {kind: 2}, body: []}
  STOP: {group: request, where: {kind: 3}, body: []}
  VALUE: {group: reply, body: [{data: values, size: 2}]}
areas: {R: {unit: word, size: 100}}
addresses: [{form: "{area}{start:dec}"}]
services:
  read:
    - {areas: [R], request: {READ: {device: device_id, source: asker, register: start}}, limit: {count: 1},
       reply: {VALUE: {device: device_id, values: data}}, back: {count: 1}}
  hello: [{request: {HELLO: {device: device_id}}, reply: {VALUE: {device: device_id, values: "h'0101'"}}},
    {request: {HELLO: {device: "h'000000'"}}, client_only: yes,
       reply: {VALUE: {device: device_id, values: "h'0202'"}}}]
  stop: [{request: {STOP: {}}, server_only: yes, reply: {VALUE: {device: device_id, values: "h'0303'"}}}]
"""


@pytest.mark.parametrize(
    ("own", "other"),
    [
        ("02 01 000001 07 05", "02 01 000002 07 05"),  # for any sender: only the client has `asker`
        ("02 02 000001", "02 02 000002"),
        ("02 02 000000", "02 02 000003"),  # a broadcast value also fills the field
        ("02 03 000001", "02 03 000002"),  # a frame that no side builds shares the field
    ],
)
def test_a_parameter_in_a_request_is_that_of_the_device(own: str, other: str) -> None:
    """A request with another value is meant for another device: it is ignored, not answered."""
    [answer] = answers(CHANNELS, own, own=None)
    assert answer[:3] == bytes.fromhex("06 0000")
    assert answers(CHANNELS, other, own=None) == []


def test_check_tells_a_parameter_that_is_not_compared() -> None:
    text = (
        CHANNELS
        + """\
sequences:
  answer:
    local: {request: frame}
    steps:
      - {step: idle, receive: [{frame: request, set: {request: it}, then: next}]}
      - {step: reply, serve: {request: request}, send: reply, then: end}
"""
    )
    [warning] = [str(warning) for warning in load_protocol_text(text).warnings if "parameter" in warning.what]
    assert "'device' of a request is not compared with the device's parameter 'device_id'" in warning
    assert "add station: own (or when: it.device == device_id)" in warning
    assert "add from: client" in warning
    compared = text.replace("frame: request, set", "frame: request, when: it.device == device_id, set")
    assert not [warning for warning in load_protocol_text(compared).warnings if "parameter" in warning.what]
