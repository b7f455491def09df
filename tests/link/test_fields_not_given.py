# ruff: noqa: E501 - definitions in YAML
"""Fields without a given value: expressions use their defaults, before and after the frame is sent."""

from __future__ import annotations

from typing import Any

import pytest
from link.link_world import MS, Side
from link.service_loop import Loop

from framekit.link.values import attribute

FRAMES = """\
protocol: left_open
station: {type: none}
params: {five: {type: number, default: 5}}
groups:
  request: {from: client, head: [{const: 01}], tail: [{check: sum8}]}
  reply: {from: server, head: [{const: 02}, {field: flag, type: u8, default: 3}], tail: [{check: sum8}]}
frames:
  ask: {group: request, body: [{field: x, type: u8}]}
  told:
    group: reply
    body:
      - {field: y, type: u8}
      - {bits: {low: 0, high: 7}, of: u8}
      - {field: kind, type: u8, values: {1: one, 2: two}, default: "'two'"}
      - {field: p, type: u8, default: five + y}
      - {field: b, type: u8, when: flag == 3, default: 9}
      - {field: c, type: u8, when: flag == 4, default: 8}
      - {field: d, type: u8, when: flag == 4}
      - {optional: [{field: e, type: u8}]}
"""
SEQUENCE = """\
sequences:
  main:
    local: {m: frame, found: list, after: list}
    gives: {found: found, after: after}
    steps:
      - step: make
        set: {m: {told: {%s}}}
      - step: look
        set: {found: "[m.flag, m.y, m.low, m.high, m.kind, m.p, m.b, m.c, either(m.d, 'nothing'), either(m.e, 'nothing'), 'c' in m]"}
      - step: send
        send: m
      - step: again
        set: {after: "[m.flag, m.y, m.low, m.high, m.kind, m.p, m.b, m.c, either(m.d, 'nothing'), either(m.e, 'nothing')]"}
roles:
  client: {lanes: {main: {exchange: main}}}
"""
USUAL = [3, 4, 0, 0, 2, 9, 9, 8, "nothing", "nothing"]


@pytest.mark.parametrize(
    ("given", "found", "sent"),
    [
        ("y: 4", USUAL, "02 03 04 00 02 09 09 1D"),
        ("y: 4, high: 1, b: 0", [3, 4, 0, 1, 2, 9, 0, 8, "nothing", "nothing"], "02 03 04 80 02 09 00 94"),
        ("y: 1, flag: 4, d: 7, kind: \"'one'\"", [4, 1, 0, 0, 1, 6, 9, 8, 7, "nothing"], "02 04 01 00 01 06 08 07 1D"),
        ("y: 1, flag: 5, e: 7", [5, 1, 0, 0, 2, 6, 9, 8, "nothing", 7], "02 05 01 00 02 06 07 17"),
    ],
)
def test_what_is_not_given_is_its_default_and_is_sent_so(given: str, found: list[Any], sent: str) -> None:
    side = Side(FRAMES + SEQUENCE % given, "client")
    side.ask()
    side.run(100 * MS)
    (outcome,) = side.outcomes
    assert outcome.ok, outcome.cause
    assert (outcome.results["found"], outcome.results["after"]) == ([*found, False], found)
    assert [data.hex(" ").upper() for data in side.taken()] == [sent]


def test_a_field_changed_later_counts_in_the_defaults_of_others() -> None:
    text = FRAMES + (SEQUENCE % "y: 4").replace("set: {found:", "set: {m.y: 6, found:")
    side = Side(text, "client")
    side.ask()
    side.run(100 * MS)
    assert side.outcomes[0].results["found"][:6] == [3, 6, 0, 0, 2, 11]


SERVED = """\
extends: standard
line: {kind: stream, tcp: 4000}
state: {sum: {scope: device, type: u16}}
services:
  put:
    - takes: {v: {type: number}}
      request: {ask: {x: v}}
      reply: {told: {y: request.x}}
      gives: {all: "[reply.flag, reply.y, reply.low, reply.high, reply.kind, reply.p, reply.b, reply.c, either(reply.d, 'nothing'), either(reply.e, 'nothing')]"}
"""


def test_the_reply_of_a_service_gives_the_same_to_client_and_server() -> None:
    loop = Loop(FRAMES + SERVED)
    result = loop.do("call", "put", {"v": 4})
    assert result.ok, result.cause
    assert result.gives["all"] == USUAL
    reply = loop.serve(loop.request(bytes.fromhex("01 04 05"))).reply
    assert [attribute(reply, name) for name in ["flag", "y", "low", "high", "kind", "p", "b", "c"]] == USUAL[:8]


RESTING = """\
protocol: resting
extends: standard
station: {type: none}
line: {kind: stream, tcp: 4000}
params: {low: {type: number, default: high - 1}, high: {type: number, default: 9}}
groups:
  request: {from: client, head: [{const: 01}]}
  reply: {from: server, head: [{const: 02}]}
frames:
  ask: {group: request, body: [{field: a, type: u8, default: b + low}, {field: b, type: u8, default: c + 1}, {field: c, type: u8}]}
  told: {group: reply, body: []}
services:
  put:
    - takes: {x: {type: number, default: y + 1}, y: {type: number, default: z + 1}, z: {type: number, default: 3}}
      request: {ask: {c: x}}
      reply: {told: {}}
      gives: {all: "[request.a, request.b, request.c, x, y, z]"}
"""


@pytest.mark.parametrize(
    ("given", "all_"), [({}, [14, 6, 5, 5, 4, 3]), ({"z": 5}, [16, 8, 7, 7, 6, 5]), ({"y": 5}, [15, 7, 6, 6, 5, 3])]
)
def test_defaults_rest_on_others_whatever_their_order(given: dict[str, int], all_: list[int]) -> None:
    result = Loop(RESTING).do("call", "put", given)
    assert result.ok, result.cause
    assert result.gives["all"] == all_


FRACTIONS = """\
protocol: fractions
extends: standard
station: {type: none}
line: {kind: stream, tcp: 4000}
groups:
  request: {from: client, head: [{const: 01}]}
  reply: {from: server, head: [{const: 02}]}
frames:
  ask: {group: request, body: [{field: a, type: i16, scale: 0.1}, {field: b, type: f32}, {field: c, type: decimal, decimals: 2, size: 5}]}
  told: {group: reply, body: [{field: y, type: u8, scale: 0.5}]}
services:
  put: [{request: {ask: {a: -1.5, b: 0.1, c: 3.25}}, reply: {told: {y: 7.5}}, gives: {y: reply.y}}]
"""


def test_fields_are_given_fractions_and_a_device_compares_them() -> None:
    loop = Loop(FRACTIONS)
    result = loop.do("call", "put", {})
    assert result.ok, result.cause
    assert str(result.gives["y"]) == "7.5"
    assert loop.log[0][0] == bytes.fromhex("01 FF F1 3D CC CC CD") + b"03.25"
    other = bytes.fromhex("01 FF F2 3D CC CC CD") + b"03.25"
    assert loop.serve(loop.request(other)).reply is None
