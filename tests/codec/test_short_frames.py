"""The diagnosis of frames that are too short: how many bytes are needed and present, never a negative size."""

from __future__ import annotations

import pytest
from small_protocol import small_protocol

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError

BYTES = "of: [{field: x, type: u8}]}"


@pytest.mark.parametrize(
    ("body", "frame", "cause"),
    [
        ("{data: d, size: rest}, {check: crc16-modbus}", "", ("short", "at least 2 bytes", "0")),
        ("{data: d, size: rest}, {check: crc16-modbus}", "03", ("short", "at least 2 bytes", "1")),
        ("{data: d, size: rest}, {check: sum8}", "", ("short", "at least 1 byte", "0")),
        ("{repeat: r, times: rest, " + BYTES + ", {data: d, size: 3}", "01 02", ("short", "at least 3 bytes", "2")),
        ("{field: n, type: u8}, {data: d, size: n - 3}", "01", ("length", "a size of at least 0", "2 less")),
        ("{field: n, type: u8}, {repeat: r, times: n - 3, " + BYTES, "00", ("length", "at least 0 items", "3 less")),
    ],
)  # fmt: skip
def test_the_bytes_that_are_needed_and_present_are_named(body: str, frame: str, cause: tuple[str, str, str]) -> None:
    codec = compile_protocol(small_protocol(f"[{body}]"))
    with pytest.raises(FrameError) as caught:
        codec.decode("f", bytes.fromhex(frame))
    assert (caught.value.cause, caught.value.expected, caught.value.found) == cause
