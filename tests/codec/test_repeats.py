"""Lists that end with an item, and what items know of themselves: as documented, in streams, and quickly."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from construct_oracle import compile_construct
from definition_trial import Trial
from link.link_world import cut_at, feed, receiver_of
from small_protocol import small_protocol

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError
from framekit.definition.load import load_protocol_text

MANUAL = Path(__file__).parents[2] / "docs" / "language.md"
ROW = re.compile(r"^\| `(\{repeat: a, .*?\})`(?::[^|]*)? \| `(\[.*?\])` \| `([0-9A-F ]+)` \|$", re.MULTILINE)
CHAIN = "[{const: 7E}, {repeat: a, until: more == 0, of: [{bits: {more: 7, v: 0-6}, of: u8}]}, {const: 7F}]"


def test_the_lists_of_the_language_reference() -> None:
    """Both compilers make the bytes of each row, and read them."""
    rows = ROW.findall(MANUAL.read_text(encoding="utf-8"))
    assert len(rows) == 8
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
    """Whole, byte by byte and cut anywhere; between them noise, and a chain that does not end in its frame."""
    text = f"protocol: p\nframes: {{f: {{max: 12, body: {CHAIN}}}}}"
    good = bytes.fromhex("7E 85 82 01 7F")
    stream = good + b"\x00" + good + bytes.fromhex("7E" + " 80" * 12) + good
    whole = feed(receiver_of(text), [stream], ("f",))
    assert [one[2] for one in whole if one[0] == "frame"] == [good] * 3
    for cuts in ([*range(len(stream))], [3, 7, 20], [1, 6, 12, 25]):
        assert feed(receiver_of(text), cut_at(stream, cuts), ("f",)) == whole


def test_a_name_of_the_definition_goes_before_the_words_of_items() -> None:
    """A field around the list, a variable, a parameter: all mean what they meant without the list."""
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
    """Items of fixed size that an earlier call has looked at are passed over."""

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
    """As a device sends them: a count, texts behind their lengths, nothing behind the last; in streams however cut."""
    text = (
        "protocol: texts\nframes:\n  texts:\n    from: server\n    body:\n      - const: 54\n"
        "      - {length: size, type: u8, of: [names]}\n      - {count: n, type: u8, of: names}\n"
        "      - repeat: names\n        times: n\n        align: 4\n        between: yes\n"
        "        of: [{length: n, type: u8, of: [text]}, {field: text, type: ascii, size: n}]\n"
        "      - {check: sum8}\n"
    )
    protocol = load_protocol_text(text, "texts")
    values = {"names": [{"text": one} for one in ("pump", "", "valve 7", "x")]}
    wire = bytes.fromhex("54 16 04 04 70756D70 000000 00 000000 07 76616C76652037 01 78")
    wire += bytes([sum(wire) & 0xFF])
    for codec in (compile_protocol(protocol), compile_construct(protocol)):
        assert codec.encode("texts", values) == wire
        assert [one["text"] for one in codec.decode("texts", wire)["names"]] == ["pump", "", "valve 7", "x"]
    stream = wire + b"\x00\x01" + wire + wire
    whole = feed(receiver_of(text), [stream], ("texts",))
    assert [one[2] for one in whole if one[0] == "frame"] == [wire] * 3
    for cuts in ([*range(len(stream))], [4, 30, 31], [9, 27, 50]):
        assert feed(receiver_of(text), cut_at(stream, cuts), ("texts",)) == whole
