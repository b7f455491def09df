"""Lists of variables: units mixed in one list, values of each item in the reply, and items that are read backwards."""

from __future__ import annotations

from link.service_loop import Loop

from framekit.link.services.client import TransferResult

PROTOCOL = """
protocol: lists
order: big
station: {type: none}
groups:
  request: {from: client, head: [{field: kind, type: u8}], tail: [{check: sum8}]}
  reply: {from: server, head: [{const: 06}], tail: [{check: sum8}]}
layouts:
  item: [{field: code, type: u8}, {field: at, type: u16}]
  told: [{field: code, type: u8}, {field: at, type: u16}, {field: bits, type: u8}, {data: data, size: (bits + 7) // 8}]
frames:
  READ:
    group: request
    where: {kind: 1}
    body: [{count: n, type: u8, of: items}, {repeat: items, times: n, of: [{include: item}]}]
  WRITE:
    group: request
    where: {kind: 2}
    body: [{count: n, type: u8, of: items}, {repeat: items, times: n, of: [{include: told}]}]
  VALUES:
    group: reply
    body: [{count: n, type: u8, of: items}, {repeat: items, times: n, of: [{include: told}]}]
  DONE: {group: reply, body: [{const: 00}]}
areas:
  D: {unit: word, size: 100, code: {word: 1, bit: 2, dword: 3}}
addresses:
  - {form: "D{start:dec}.{bit:hex:1}", area: D, unit: bit, start: start * 16 + bit}
  - {form: "D{start:dec}", area: D, unit: word}
  - {form: "L{start:dec}", area: D, unit: dword, counts: word}
services:
  read:
    - variables: {max: 10}
      units: [bit, word]
      limit: {count: 1}
      request: {READ: {items: {each: {code: code, at: start ^ 0x55}}}}
      back: {each: {start: at ^ 0x55}}
      reply: {VALUES: {items: {each: {code: code, at: start, bits: "1 if unit == 'bit' else bytes * 8", data: data}}}}
      packing: {order: big}
  write:
    - variables: {max: 10}
      units: [bit, word]
      limit: {count: 1}
      request:
        WRITE: {items: {each: {code: code, at: start ^ 0x55, bits: "1 if unit == 'bit' else bytes * 8", data: data}}}
      back: {each: {start: at ^ 0x55}}
      reply: {DONE: {}}
      packing: {order: big}
"""
ADDRESSES = ["D1", "D2.F", "L3", "D2"]


def test_a_list_of_words_bits_and_double_words() -> None:
    loop = Loop(PROTOCOL)
    loop.memory.write("D", "word", 1, [0x1234, 0x8000, 0x5678, 0x9ABC])
    done: list[TransferResult] = []
    loop.client.read_variables(ADDRESSES, now=0, on_done=done.append)
    assert done[0].values == [0x1234, 1, 0x9ABC5678, 0x8000]  # a double word at an odd word is two items
    ((request, reply, _),) = loop.log
    assert request.hex(" ").startswith("01 05 01 00 54 02 00 7a 01 00 56 01 00 51 01 00 57")
    assert reply.hex(" ").startswith("06 05 01 00 01 10 12 34 02 00 2f 01 01 01 00 03 10 56 78")


def test_a_list_is_written_item_by_item() -> None:
    loop = Loop(PROTOCOL)
    done: list[TransferResult] = []
    loop.client.write_variables(ADDRESSES[:3], [0x1234, 1, 0x9ABC5678], now=0, on_done=done.append)
    assert done[0].ok
    assert loop.memory.read("D", "word", 1, 4) == [0x1234, 0x8000, 0x5678, 0x9ABC]
    assert len(loop.log) == 1
