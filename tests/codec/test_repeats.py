"""Lists that end with an item, and words of items: as documented, in streams, and quickly."""

from __future__ import annotations

import cProfile
import json
import pstats
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from construct_oracle import compile_construct
from definition_trial import Trial
from link.link_world import cut_at, feed, receiver_of
from small_protocol import small_protocol

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text

MANUAL = Path(__file__).parents[2] / "docs" / "language" / "lists.md"
ROW = re.compile(r"^\| `(\{repeat: a, .*?\})`(?::[^|]*)? \| `(\[.*?\])` \| `([0-9A-F ]+)` \|$", re.MULTILINE)
CHAIN = "[{const: 7E}, {repeat: a, until: more == 0, of: [{bits: {more: 7, v: 0-6}, of: u8}]}, {const: 7F}]"


def test_the_lists_of_the_language_reference() -> None:
    """Both compilers make the bytes of each row, and read them."""
    rows = ROW.findall(MANUAL.read_text(encoding="utf-8"))
    assert len(rows) == 9
    for segment, items, wire in rows:
        protocol = small_protocol(f"[{segment}]")
        for codec in (compile_protocol(protocol), compile_construct(protocol)):
            made = codec.encode("f", {"a": json.loads(items)})
            assert made == bytes.fromhex(wire), segment
            assert codec.encode("f", codec.decode("f", made)) == made


@pytest.mark.parametrize(
    "items", [[], [(0, 1), (0, 2)], [(1, 1)], [(1, 1), (0, 2), (0, 3)]], ids=["none", "soon", "never", "more"]
)
def test_a_list_ends_with_the_item_that_says_so(items: list[tuple[int, int]]) -> None:
    values = {"a": [{"more": more, "v": v} for more, v in items]}
    protocol = small_protocol(CHAIN)
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        with pytest.raises(EncodeError, match=r"at least one item|must hold in the last item and in no other"):
            codec.encode("f", values)


def test_chains_in_a_stream() -> None:
    """Whole, byte by byte and cut anywhere; between the chains are noise and a chain longer than its frame."""
    text = f"protocol: p\nframes: {{f: {{max: 12, body: {CHAIN}}}}}"
    good = bytes.fromhex("7E 85 82 01 7F")
    stream = good + b"\x00" + good + bytes.fromhex("7E" + " 80" * 12) + good
    whole = feed(receiver_of(text), [stream], ("f",))
    assert [event[2] for event in whole if event[0] == "frame"] == [good] * 3
    for cuts in ([*range(len(stream))], [3, 7, 20], [1, 6, 12, 25]):
        assert feed(receiver_of(text), cut_at(stream, cuts), ("f",)) == whole


def test_a_name_of_the_definition_goes_before_the_words_of_items() -> None:
    """A field around the list, a state variable and a parameter keep their meaning.

    They hide an item word of the same name.
    """
    item = "{repeat: a, times: 2, of: [{field: v, type: u8, is: index}]}"
    for sections, body, wanted in (
        ((), f"[{{field: index, type: u8}}, {item}]", "07 07 07"),
        (("params: {index: {type: number, default: 5}}",), f"[{{field: b, type: u8}}, {item}]", "07 05 05"),
        (("state: {index: {scope: line, type: u8, initial: 6}}",), f"[{{field: b, type: u8}}, {item}]", "07 06 06"),
        ((), f"[{{field: b, type: u8}}, {item}]", "07 00 01"),
    ):
        protocol = small_protocol(body, *sections)
        for codec in (compile_protocol(protocol), compile_construct(protocol)):
            first = "index" if "index, type" in body else "b"
            made = codec.encode("f", {first: 7, "a": [{}, {}]})
            assert made.hex(" ") == wanted, (sections, body)


TRIALS: dict[str, tuple[str, dict[str, Any]]] = {
    "lists in lists, each with its own number": (
        "[{repeat: d, until: index == 2, of: [{field: v, type: u8}, {repeat: e, until: w == 0, of:"
        " [{field: w, type: u8}, {field: y, type: u8, is: index}]}, {field: g, type: u8, is: index}]}]",
        {"d": [{"v": 1, "e": [{"w": 1}, {"w": 0}]}, {"v": 1, "e": [{"w": 0}]}, {"v": 2, "e": [{"w": 0}]}]},
    ),
    "a size that stands on the item before": (
        "[{repeat: d, until: k == 0, of: [{field: k, type: u8}, {include: r, as: r},"
        " {data: z, size: 'either(previous.r.n, 0)'}]}]",
        {"d": [{"k": 1, "r": {"a": 2}, "z": b""}, {"k": 0, "r": {"a": 1}, "z": b"abc"}]},
    ),
    "whether it is the last, in cases and wraps of an item": (
        "[{repeat: d, until: k == 0, of: [{field: k, type: u8},"
        " {choose: k, cases: {1: [{field: c, type: u8, is: last}],"
        " 2: [{wrap: hex, of: [{field: c, type: u8, is: last}]}]}, else: []}]}]",
        {"d": [{"k": 1}, {"k": 2}, {"k": 0}]},
    ),
    "aligned in a wrap, and the last one known by its end": (
        "[{field: k, type: u8}, {wrap: {escape: 10}, of: [{repeat: d, times: rest, align: 4, fill: 10, of:"
        " [{length: n, type: u8, of: [s]}, {data: s, size: n}, {field: e, type: u8, is: last}]}]}, {const: 10 03}]",
        {"k": 1, "d": [{"s": b"a"}, {"s": b""}, {"s": b"ab\x10"}]},
    ),
    "the last one before the end of the region": (
        "[{repeat: d, times: rest, of: [{bits: {more: 7, v: 0-6}, of: u8, is: {more: not last}}]},"
        " {field: e, type: u8}]",
        {"d": [{"v": 1}, {"v": 3}, {"v": 2}], "e": 1},
    ),
}


@pytest.mark.parametrize("name", TRIALS)
def test_what_items_know_of_themselves(name: str) -> None:
    body, values = TRIALS[name]
    layouts = "layouts: {r: [{field: a, type: u8}, {field: n, type: u8, is: a + 1}]}"
    for seed in range(5):
        text = f"protocol: p\n{layouts if 'include' in body else ''}\nframes: {{f: {{body: {body}}}}}"
        assert Trial(text, dict(values), seed).run() is not None


def test_a_chain_that_comes_byte_by_byte_is_not_walked_again() -> None:
    """Items of fixed size that an earlier call has read are skipped."""

    class Counted(bytes):
        looked_at = 0

        def __getitem__(self, key: Any) -> Any:
            Counted.looked_at += isinstance(key, int)
            return super().__getitem__(key)

    codec = compile_protocol(small_protocol(CHAIN, keys="max: 4000"))
    data = Counted(b"\x7e" + b"\x80" * 3000)
    for have in range(1, len(data) + 1):
        assert codec.measure("f", data, 0, have, None, have - 1) < 0
    assert Counted.looked_at < 6 * len(data)


def test_a_list_of_texts_each_at_a_multiple_of_4() -> None:
    """A message of a real device: a count, texts with lengths, padding between items but not after the last.

    Streams are cut anywhere.
    """
    text = (
        "protocol: texts\nframes:\n  texts:\n    from: server\n    body:\n      - const: 54\n"
        "      - {length: size, type: u8, of: [names]}\n      - {count: n, type: u8, of: names}\n"
        "      - repeat: names\n        times: n\n        align: 4\n        between: yes\n"
        "        of: [{length: n, type: u8, of: [text]}, {field: text, type: ascii, size: n}]\n"
        "      - {check: sum8}\n"
    )
    protocol = load_protocol_text(text, "texts")
    values = {"names": [{"text": text} for text in ("pump", "", "valve 7", "x")]}
    wire = bytes.fromhex("54 16 04 04 70756D70 000000 00 000000 07 76616C76652037 01 78")
    wire += bytes([sum(wire) & 0xFF])
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.encode("texts", values) == wire
        assert [name["text"] for name in codec.decode("texts", wire)["names"]] == ["pump", "", "valve 7", "x"]
    stream = wire + b"\x00\x01" + wire + wire
    whole = feed(receiver_of(text), [stream], ("texts",))
    assert [event[2] for event in whole if event[0] == "frame"] == [wire] * 3
    for cuts in ([*range(len(stream))], [4, 30, 31], [9, 27, 50]):
        assert feed(receiver_of(text), cut_at(stream, cuts), ("texts",)) == whole


# ---- M-Bus: records whose extension bits tell how long they are -------------------------------------------------

M_BUS = """
protocol: meter
order: little
tables: {sizes: {1: 1, 2: 2, 3: 3, 4: 4, 5: 4, 6: 6, 7: 8, 9: 1, 10: 2, 11: 3, 12: 4, 14: 6}}
layouts:
  extension: [{bits: {more: 7, unit: 6, tariff: 4-5, storage: 0-3}, of: u8, is: {more: not last}}]
  record:
    - {bits: {extended: 7, storage: 6, function: 4-5, coding: 0-3}, of: u8}
    - {repeat: difes, when: extended, until: not more, of: [{include: extension}]}
    - {bits: {vif_extended: 7, vif: 0-6}, of: u8}
    - repeat: vifes
      when: vif_extended
      until: not more
      of: [{bits: {more: 7, code: 0-6}, of: u8, is: {more: not last}}]
    - {data: raw, size: "get(sizes, coding, 0)"}
frames:
  reply:
    from: server
    max: 261
    body:
      - const: 68
      - {length: size, type: u8, of: [content]}
      - {field: again, type: u8, is: size}
      - const: 68
      - wrap: none
        name: content
        size: size
        of:
          - {field: control, type: u8, default: 8}
          - {field: address, type: u8}
          - const: 72
          - {field: number, type: bcd, size: 4, order: little}
          - {data: header, size: 8}
          - {repeat: records, times: rest, of: [{include: record}]}
      - {check: sum8, over: control..here}
      - const: 16
"""
REPLY = bytes.fromhex(
    "681F1F68 080272 78563412 24400107 55000000 0313153100 DA023B1301 8B6004371802 1816"
)  # The M-Bus: A Documentation, 4.8: a reply with variable data structure
SIMPLE = {"extended": 0, "storage": 0, "function": 0, "vif_extended": 0}
DIFE = {"more": 0, "unit": 0, "tariff": 0, "storage": 0}
RECORDS = [
    SIMPLE | {"coding": 3, "vif": 0x13, "raw": b"\x15\x31\0"},
    SIMPLE
    | {"extended": 1, "storage": 1, "function": 1, "coding": 10, "vif": 0x3B, "raw": b"\x13\x01"}
    | {"difes": [DIFE | {"storage": 2}]},
    SIMPLE
    | {"extended": 1, "coding": 11, "vif": 4, "raw": b"\x37\x18\x02"}
    | {"difes": [DIFE | {"unit": 1, "tariff": 2}]},
]


def test_records_of_a_meter() -> None:
    """The published reply, and longer chains of which only the number of extensions is published."""
    protocol = load_protocol_text(M_BUS, "meter")
    long = {"extended": 1, "storage": 0, "function": 0, "coding": 1, "vif_extended": 1, "vif": 0x7D, "raw": b"\x05"}
    long |= {"difes": [{"unit": 0, "tariff": 1, "storage": n} for n in range(3)], "vifes": [{"code": 1}, {"code": 2}]}
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        read = codec.decode("reply", REPLY)
        assert (read["number"], read["address"], read["records"]) == (12345678, 2, RECORDS)
        assert codec.encode("reply", read) == REPLY
        values = {"address": 1, "number": 1, "header": bytes(8), "records": [long]}
        made = codec.encode("reply", values)
        assert made[19:-2] == bytes.fromhex("81 90 91 12 FD 81 02 05")
        with pytest.raises(EncodeError, match="at least one item"):
            codec.encode("reply", values | {"records": [{**long, "difes": []}]})


def test_records_of_a_meter_in_a_stream() -> None:
    damaged = REPLY[:20] + b"\xff" * 11 + REPLY[31:]
    stream = b"\xe5" + REPLY + damaged + REPLY
    whole = feed(receiver_of(M_BUS), [stream], ("reply",))
    assert [event[2] for event in whole if event[0] == "frame"] == [REPLY, REPLY]
    for cuts in ([*range(len(stream))], [3, 40, 77], [1, 20, 38, 39, 99]):
        assert feed(receiver_of(M_BUS), cut_at(stream, cuts), ("reply",)) == whole


# ---- a tree of tag, length, value ---------------------------------------------------------------------------------

TREE = next(block for block in MANUAL.read_text("utf-8").split("```") if "# file: tree.yaml" in block)
TREE = TREE.removeprefix("yaml\n")


def leaf(tag: int, value: bytes) -> dict[str, Any]:
    return {"tlv": {"tag": tag, "value": value}}


def node(*items: dict[str, Any]) -> dict[str, Any]:
    return {"tlv": {"tag": 0x20, "items": list(items)}}


def test_a_tree_as_documented() -> None:
    protocol = load_protocol_text(TREE, "tree")
    tree = {"tag": 32, "items": [leaf(1, bytes.fromhex("61 62 63"))]}
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.encode("tree", tree) == bytes.fromhex("54 20 05 01 03 61 62 63")
        read = codec.decode("tree", bytes.fromhex("54 20 05 01 03 61 62 63"))
        assert read == {"tag": 32, "n": 5, "items": [{"tlv": {"tag": 1, "n": 3, "value": b"abc"}}]}


def test_a_tree_in_every_way() -> None:
    values = node(leaf(1, b"ab"), node(leaf(2, b""), node(leaf(3, b"xyz"), leaf(3, b""))), leaf(4, b"q"))["tlv"]
    text = TREE.replace("tree: {body: [", "f: {body: [")
    for seed in range(10):
        assert Trial(text, dict(values), seed).run() is not None


def test_a_tree_is_no_deeper_than_said() -> None:
    """Values nested too deep are refused; bytes nested too deep are a fault at that offset."""
    protocol = load_protocol_text(TREE, "tree")
    fits, deeper = node(node(node(leaf(1, b"")))), node(node(node(node(leaf(1, b"")))))
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.decode("tree", codec.encode("tree", fits["tlv"]))["items"]
        with pytest.raises(EncodeError):
            codec.encode("tree", deeper["tlv"])
        with pytest.raises(FrameError) as caught:
            codec.decode("tree", bytes.fromhex("54 20 08 20 06 20 04 20 02 01 00"))
        assert (caught.value.cause, caught.value.offset) == ("require", 9)


def test_a_tree_in_a_stream() -> None:
    tree = compile_protocol(load_protocol_text(TREE, "tree")).encode(
        "tree", node(node(leaf(1, b"ab")), leaf(2, b""))["tlv"]
    )
    stream = tree + b"\x01" + tree + bytes.fromhex("54 20 04 01 07 00 00") + tree
    whole = feed(receiver_of(TREE), [stream], ("tree",))
    assert [event[2] for event in whole if event[0] == "frame"] == [tree] * 3
    for cuts in ([*range(len(stream))], [3, 13, 30], [1, 12, 25]):
        assert feed(receiver_of(TREE), cut_at(stream, cuts), ("tree",)) == whole


def test_work_for_nested_lists_is_bounded() -> None:
    """The number of calls is bounded for any bytes: each byte costs at most the work of one level per level."""
    layouts = (
        "layouts: {node: [{field: v, type: u8}, {count: n, type: u8, of: below},"
        " {repeat: below, times: n, of: [{include: node, as: node, depth: 32}]}]}"
    )
    codec = compile_protocol(small_protocol("[{include: node}]", layouts))
    for data in (b"\x01\x01" * 31 + b"\x01\x00", b"\x01\x02" * 300, (b"\x01\xff" + b"\x01\x00" * 255) * 2):
        profile = cProfile.Profile()
        profile.enable()
        codec.measure("f", data)
        with suppress(FrameError):
            codec.decode("f", data).get("below")
        profile.disable()
        assert pstats.Stats(profile).total_calls < 100 * len(data)  # type: ignore[attr-defined]
