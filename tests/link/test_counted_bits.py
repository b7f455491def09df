"""A server writes as many bits as the request names; the bits after them do not change."""

from __future__ import annotations

from link.link_world import SECOND, Side, compiled

from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

POINTS = """\
protocol: points
extends: standard
station: {type: number, range: 0..9, default: 1}
areas: {B: {unit: bit, size: 16}}
addresses: [{form: "{area}{start:dec}"}]
groups:
  request: {from: client, head: [{const: 01}, {field: station, type: u8}]}
frames:
  set: {group: request, body: [{field: start, type: u8}, {field: a, type: u8}, {field: b, type: u8}]}
  done: {from: server, body: [{const: 06}]}
services:
  write:
    - areas: [B]
      request: {set: {station: station, start: start, a: "bits[0]", b: "bits[1]"}}
      back: {start: request.start, bits: "[request.a, request.b]"}
      limit: {count: 2}
      reply: {done: {}}
"""


def test_bits_that_back_names_are_counted() -> None:
    protocol, codec = compiled(POINTS)
    memory = DeviceMemory(memory_of(protocol)[0])
    memory.write("B", "bit", 0, [1] * 16)
    side = Side(POINTS, "server", own=1, server=MemoryServer(protocol, codec, memory))
    side.gets(bytes.fromhex("01 01 04 00 00"))
    side.run(SECOND)
    assert side.taken() == [b"\x06"]
    assert memory.read("B", "bit", 0, 8) == [1, 1, 1, 1, 0, 0, 1, 1]
