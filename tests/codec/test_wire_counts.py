"""Counts and sizes on the wire are compared with the bytes that are present before memory is allocated."""

from __future__ import annotations

import tracemalloc
from array import array
from collections.abc import Callable
from io import BytesIO
from typing import Any

import pytest
from construct_oracle import compile_construct
from definition_trial import Trial
from link_world import receiver_of

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.columns import Cut
from framekit.codec.construct import CompiledFrame
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.python.measure import MOST
from framekit.definition.load.protocol import load_protocol_text
from framekit.extras.batch.batch import BatchDecoder

MANY = 1 << 22
ROOM = MANY
"""Largest number of bytes of memory that reading may allocate for any frame."""

TYPES = (
    "u8", "u24", "u40", "i64", "u32, order: CDAB", "u16, order: little", "f64", "hex, size: 4", "dec, size: 3",
    "bcd, size: 2", "hex, size: 4, order: little", "ascii, size: 2", "bytes, size: 2", "uint, size: 3",
)  # fmt: skip
"""Types of list items."""
COUNTED = {
    **{f"a list of {of}": f"{{repeat: d, times: n, of: {of}}}" for of in TYPES},
    "a list of records": "{repeat: d, times: n, of: [{field: x, type: u8}]}",
    "a list of records of any size": "{repeat: d, times: n, of: [{length: l, type: u8, of: e}, {data: e, size: l}]}",
    "a list of records that may be empty": "{repeat: d, times: n, of: [{field: x, type: u8, when: n == 2}]}",
    "a list of lists": "{repeat: d, times: n, of: [{repeat: e, times: n, of: [{field: x, type: u8, when: n == 2}]}]}",
    "bytes": "{data: d, size: n}",
    "bytes as digits": "{data: d, size: n, convert: hex_to_ascii, swap: 2}",
    "bytes that are filled up": "{data: d, size: n * 4, pad: 00}",
    "a text": "{field: d, type: ascii, size: n, pad: 20}",
    "a number": "{field: d, type: uint, size: n}",
    "digits": "{field: d, type: hex, size: n}",
    "a wrap": "{wrap: hex, of: [{repeat: d, times: n, of: u24}]}",
    "a frame": "{inner: d, of: [g], size: n}",
}  # fmt: skip


def text_of(counted: str) -> str:
    behind = "{field: z, type: u8, when: len(d) > 2}"  # the end of the frame depends on the counted data
    if any(kind in counted for kind in ("inner", "wrap", "field: d")):
        behind = "{const: 7E}"
    body = f"[{{const: 05}}, {{field: n, type: u32}}, {counted}, {behind}]"
    return f"protocol: counts\nframes: {{f: {{body: {body}}}, g: {{body: [{{data: rest, size: rest}}]}}}}"


def most_room(work: Callable[[], Any]) -> int:
    """Return the peak memory of a call, in bytes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def refused(read: Callable[[], Any]) -> None:
    with pytest.raises(FrameError):
        read()


@pytest.mark.parametrize("title", COUNTED)
def test_nothing_is_made_of_a_count_that_is_not_there(title: str) -> None:
    """Decoding, `trace`, the receiver and the construct codec allocate no more memory than the present bytes need."""
    text = text_of(COUNTED[title])
    codec: Codec = compile_protocol(load_protocol_text(text, "counts"))
    data = b"\x05" + MANY.to_bytes(4, "big") + b"0123"
    reference = compile_construct(codec.protocol)
    refused(lambda: codec.decode("f", data))  # create everything that is created once
    for read in (
        lambda: refused(lambda: codec.decode("f", data)),
        lambda: codec.trace("f", data),
        lambda: refused(lambda: reference.decode("f", data)),
        lambda: BatchDecoder(codec, "f").decode(Cut(data, array("q", [0]), array("q", [len(data)]))),
    ):
        assert most_room(read) < ROOM
    for have in range(len(data) + 1):
        wanted = codec.measure("f", data, 0, have)
        assert wanted in (codec.LOST, codec.QUIET) or -MOST <= wanted <= len(data), wanted
    receiver = receiver_of(text)
    receiver.append(data, 0)
    assert most_room(lambda: receiver.next(("f",))) < ROOM


@pytest.mark.parametrize("title", COUNTED)
def test_no_more_of_a_stream_is_read_than_a_frame_may_have(title: str) -> None:
    """A buffered file allocates memory for all requested bytes."""
    codec = compile_protocol(load_protocol_text(text_of(COUNTED[title]), "counts"))
    sizes = []

    class Stream(BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            sizes.append(size)
            return super().read(size)

    with pytest.raises(FrameError):
        CompiledFrame(codec, codec.protocol.frames, "f", lambda _: codec.defaults).parse_stream(
            Stream(b"\x05" + MANY.to_bytes(4, "big") + b"0123")
        )
    assert sizes and all(size is None or size <= MOST for size in sizes)


def test_an_item_of_a_counted_list_takes_bytes() -> None:
    """Otherwise a count without data would be any number of items, and nested lists the square of that."""
    body = "[{field: n, type: u8}, {repeat: r, times: n, of: [{field: x, type: u8, when: n == 2}]}, {const: 7E}]"
    text = f"protocol: counts\nframes: {{f: {{body: {body}}}}}"
    assert Trial(text, {"n": 2, "r": [{"x": 1}, {"x": 2}]}).run() == b"\x02\x01\x02\x7e"
    codec = compile_protocol(load_protocol_text(text, "counts"))
    for either in (codec, compile_construct(codec.protocol)):
        with pytest.raises(EncodeError) as caught:
            either.encode("f", {"n": 1, "r": [{}]})
        assert (caught.value.field, str(caught.value)) == (
            "r[0]",
            "'r[0]' takes no bytes, so nothing shows that it is there",
        )
        with pytest.raises(FrameError):
            either.decode("f", b"\x01\x7e")


def test_items_of_a_fixed_number_may_be_empty() -> None:
    """For instance, a bit per item gives its presence."""
    items = "{repeat: r, times: 8, of: [{field: x, type: u8, when: 'bit(k, len(r))'}]}"
    text = f"protocol: counts\nframes: {{f: {{body: [{{field: k, type: u8}}, {items}]}}}}"
    rows: list[dict[str, int]] = [{"x": 1}, {}, {"x": 3}, {}, {}, {}, {}, {}]
    assert Trial(text, {"k": 5, "r": rows}).run() == b"\x05\x01\x03"
