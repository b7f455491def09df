# ruff: noqa: E501 - definitions in YAML
"""Lists of variables: mixed units in one list, or a list per unit; values of each item; inverse evaluation of items."""

from __future__ import annotations

from random import Random

import pytest
from link.service_loop import Loop

from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError
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


SPLIT = """
protocol: split
order: big
station: {type: none}
groups:
  request: {from: client, head: [{field: kind, type: u8}], tail: [{check: sum8}]}
  reply: {from: server, head: [{const: 06}], tail: [{check: sum8}]}
layouts:
  sizes: [{count: n, type: u8, of: words}, {count: m, type: u8, of: doubles}]
  item: [{field: code, type: u8}, {field: at, type: u16}]
frames:
  READ:
    group: request
    where: {kind: 1}
    body: [{include: sizes}, {repeat: words, times: n, of: [{include: item}]}, {repeat: doubles, times: m, of: [{include: item}]}]
  WRITE:
    group: request
    where: {kind: 2}
    body:
      - {include: sizes}
      - {repeat: words, times: n, of: [{include: item}]}
      - {repeat: doubles, times: m, of: [{include: item}]}
      - {repeat: low, times: n, of: [{data: data, size: 2}]}
      - {repeat: high, times: m, of: [{data: data, size: 4}]}
  VALUES:
    group: reply
    body:
      - {include: sizes}
      - {repeat: doubles, times: m, of: [{data: data, size: 4}]}
      - {repeat: words, times: n, of: [{data: data, size: 2}]}
  DONE: {group: reply, body: [{const: 00}]}
areas:
  D: {unit: word, size: 100, code: 1}
  M: {unit: bit, size: 320, code: 2}
addresses:
  - {form: "{area}{start:dec}"}
  - {form: "L{start:dec}", area: D, unit: dword, counts: word}
services:
  read:
    - variables: {max: 5}
      limit: {count: 2}
      request: {READ: {words: {each: {code: code, at: start}, when: bytes == 2}, doubles: {each: {code: code, at: start}, when: bytes == 4}}}
      reply: {VALUES: {words: {each: {data: data}, when: bytes == 2}, doubles: {each: {data: data}, when: bytes == 4}}}
  write:
    - variables: {max: 5}
      align: {bits: 16}
      limit: {count: 2}
      request:
        WRITE:
          words: {each: {code: code, at: start}, when: bytes == 2}
          doubles: {each: {code: code, at: start}, when: bytes == 4}
          low: {each: {data: data}, when: bytes == 2}
          high: {each: {data: data}, when: bytes == 4}
      reply: {DONE: {}}
"""


def read(loop: Loop, addresses: list[str]) -> TransferResult:
    done: list[TransferResult] = []
    loop.client.read_variables(addresses, now=0, on_done=done.append)
    return done[0]


def test_words_and_double_words_have_a_list_each() -> None:
    loop = Loop(SPLIT)
    loop.memory.write("D", "word", 0, list(range(100, 200)))
    assert read(loop, ["D5", "L7", "D3", "L0"]).values == [105, 108 << 16 | 107, 103, 101 << 16 | 100]
    ((request, reply, _),) = loop.log
    assert request[:-1].hex(" ") == "01 02 02 01 00 05 01 00 03 01 00 07 01 00 00"
    assert reply[:-1].hex(" ") == "06 02 02 00 6b 00 6c 00 64 00 65 00 69 00 67"


def test_any_mixture_comes_back_in_the_order_it_was_asked_for() -> None:
    random, loop = Random(17), Loop(SPLIT)
    words = [0] * 100
    for _ in range(50):
        items = {2 * at: random.choice("DL") for at in random.sample(range(50), random.randrange(1, 12))}
        wanted = {f"{letter}{at}": random.randrange(1 << (16 if letter == "D" else 32)) for at, letter in items.items()}
        del loop.log[:]
        done: list[TransferResult] = []
        loop.client.write_variables(list(wanted), list(wanted.values()), now=0, on_done=done.append)
        assert done[0].ok and done[0].written == sum(1 if letter == "D" else 2 for letter in items.values())
        for (at, letter), value in zip(items.items(), wanted.values(), strict=True):
            words[at : at + 1 + (letter == "L")] = [value & 0xFFFF, value >> 16][: 1 + (letter == "L")]
        assert loop.memory.read("D", "word", 0, 100) == words
        assert read(loop, list(wanted)).values == list(wanted.values())
        assert len(loop.log) == 2 * -(-len(items) // 5)


def test_a_device_serves_whatever_area_stands_in_the_lists() -> None:
    loop = Loop(SPLIT)
    loop.memory.write("D", "word", 1, [0x1234])
    loop.memory.write("M", "bit", 3, [1] * 20)

    def answer(wire: str) -> str:
        data = bytes.fromhex(wire)
        return loop.answer(data + bytes((sum(data) & 0xFF,)))[:-1].hex(" ")

    assert answer("01 02 01 01 00 01 02 00 03 02 00 02") == "06 02 01 fe ff 1f 00 12 34 ff ff"
    assert answer("02 01 01 02 00 20 01 00 05 81 00 01 02 03 04") == "06 00"
    assert loop.memory.read("M", "bit", 32, 16) == [1, 0, 0, 0, 0, 0, 0, 1] + [0] * 8
    assert loop.memory.read("D", "word", 5, 2) == [0x0102, 0x0304]


WRONG = """
protocol: wrong
extends: standard
station: {type: none}
groups: {request: {from: client}}
layouts: {sizes: [{count: n, type: u8, of: words}, {count: m, type: u8, of: doubles}]}
frames:
  READ:
    group: request
    body: [{const: 01}, {include: sizes}, {repeat: words, times: n, of: [{field: at, type: u8}]}, {repeat: doubles, times: m, of: [{field: at, type: u8}]}]
  VALUES:
    from: server
    body: [{const: 06}, {include: sizes}, {repeat: words, times: n, of: [{data: v, size: 2}]}, {repeat: doubles, times: m, of: [{data: v, size: 4}]}]
areas: {D: {unit: word, size: 100}}
addresses: [{form: "D{start:dec}", area: D}]
services:
  read:
    - areas: [D]
      variables: {max: 5}
      limit: {count: 2}
      request: {READ: {words: {each: {at: start}%s}, doubles: {each: {at: start}%s}}}
      reply: {VALUES: {words: {each: {v: data}%s}, doubles: {each: {v: data}, when: count == 2}}}
"""


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ((", when: count == 1", "", ", when: count == 1"), "this one does not say for which"),
        ((", when: count == 1", ", when: count == 2", ""), "this one does not say for which"),
        ((", when: count < 2", ", when: count == 2", ", when: count == 1"), "cannot tell from 'count < 2' what the items"),
        ((", when: start == 1", ", when: count == 2", ", when: count == 1"), "cannot tell from 'start == 1' what the items"),
        (
            (", when: count == 1", ", when: \"unit == 'word'\"", ", when: count == 1"),
            "in two lists: 'count == 1' and 'unit == 'word'' may both hold",
        ),
        ((", when: cuont == 1", ", when: count == 2", ", when: count == 1"), "there is no name 'cuont' here"),
    ],
)  # fmt: skip
def test_check_tells_lists_that_are_not_certain(conditions: tuple[str, ...], message: str) -> None:
    with pytest.raises(DefinitionError, match=message):
        load_protocol_text(WRONG % conditions, "wrong")


def test_elements_that_no_list_is_for_go_by_another_row() -> None:
    loop = Loop(SPLIT)
    done: list[TransferResult] = []
    with pytest.raises(ValueError, match="no request can read"):
        loop.client.read_variables(["M3"], now=0, on_done=done.append)
