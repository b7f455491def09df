"""A fault inside an inner frame is reported as the fault of the outer frame."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from extras.generate_c.c_harness import GCC, CProtocol, differences, mutated

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.functions import fitting, reason
from framekit.definition.load.protocol import load_protocol_text

PDU = """
protocol: inside
groups: {pdu: {from: none, head: [{field: function, type: u8}]}}
frames:
  read: {group: pdu, where: {function: 3}, body: [{field: address, type: u16}, {field: count, type: u8, range: 1..125}]}
  write: {group: pdu, where: {function: 6}, body: [{length: n, type: u8, of: [d]}, {data: d, size: n}, {check: xor8}]}
  more: {group: pdu, where: {function: 9}, body: [{field: k, type: u8}, {inner: of, of: [write]}, {data: e, size: k}]}
  open: {body: [{field: station, type: u8}, {inner: pdu, of: [pdu]}, {field: n, type: u8}, {data: d, size: n}]}
  known: {body: [{field: station, type: u8}, {inner: pdu, of: [pdu]}, {field: tag, type: u8}]}
"""


def codec_of() -> Codec:
    return compile_protocol(load_protocol_text(PDU, "inside"))


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        ("01 03 00 02 C8 00", "pdu.read.count at byte 4: range, expected 1..125, found 200"),
        ("01 06 02 41 42 00 00", "pdu.write.check at byte 5: check, expected 07, found 00"),
        ("01 06 09 41", "pdu.write.d at byte 3: short, expected 9 bytes, found 1"),
        ("01 09 02 06 01 41 00 0D 0D 00", "pdu.more.of.write.check at byte 6: check, expected 46, found 00"),
        ("01 09 02 06 01 41 46 0E", "pdu.more.e at byte 7: short, expected 2 bytes, found 1"),
        ("01 77 00", "pdu.read.function at byte 1: where, expected 3, found 119"),
    ],
)
def test_where_no_frame_fits_the_fault_is_that_of_the_frame_read_furthest(data: str, fault: str) -> None:
    codec = codec_of()
    with pytest.raises(FrameError) as caught:
        codec.decode("open", bytes.fromhex(data))
    assert str(caught.value) == fault
    fits, faults = fitting(codec, codec.protocol.frames, bytes.fromhex(data), ["open"])
    assert (fits, reason(codec, faults, bytes.fromhex(data))) == ([], f"no frame fits; nearest is 'open': {fault}")


def test_bytes_of_known_size_that_are_no_frame_are_kept_and_explained() -> None:
    codec, data = codec_of(), bytes.fromhex("01 03 00 02 C8 07")
    assert codec.decode("known", data)["pdu"] == {"unknown": {"data": data[1:5]}}
    why = "pdu is none of its frames; nearest: pdu.read.count at byte 4: range, expected 1..125, found 200"
    assert codec.check_warnings("known", data) == [why]
    assert codec.check_warnings("known", bytes.fromhex("01 03 00 02 08 07")) == []


@pytest.mark.skipif(GCC is None, reason="there is no C compiler")
def test_c_finds_the_same_fault(tmp_path: Path) -> None:
    c, random_ = CProtocol(load_protocol_text(PDU, "inside"), tmp_path), Random(11)
    frames = [
        (frame, bad)
        for frame in ("open", "known")
        for sample in c.samples(frame, 8)
        for bad in mutated(random_, sample, 40)
    ]
    assert differences(c, frames) == []
