# ruff: noqa: E501 - definitions in YAML
"""The quick test of check codes never skips a frame that the codec would accept or refuse."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from spread import spread

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.sources import shipped_definitions
from framekit.link.frame_table import table_of
from framekit.link.quick_look import intact_of
from framekit.link.scope import Scope

NAMES = sorted(path.name.split(".")[0] for path in shipped_definitions() if path.name.count(".") == 1)


def test_some_shipped_frames_have_it() -> None:
    found = {
        name for name in NAMES for frame in load_protocol(name).frames.values() if intact_of(frame) is not None
    }  # fmt: skip
    assert {"modbus-rtu", "ge-rtu", "host-link", "df1"} <= found


@pytest.mark.parametrize("name", spread(NAMES, 3))
def test_it_agrees_with_the_codec_on_good_and_damaged_frames(name: str) -> None:
    protocol = load_protocol(name)
    codec = compile_protocol(protocol)
    scope = Scope(protocol, role=next(iter(protocol.roles), None))
    for frame in protocol.frames.values():
        intact = intact_of(frame)
        if intact is None:
            continue
        for sample in Sampler(codec, scope).samples(frame.name):
            assert intact(sample.data)
            for place in range(len(sample.data)):
                damaged = bytearray(sample.data)
                damaged[place] ^= 1 << place % 8
                if not intact(bytes(damaged)):
                    with pytest.raises(FrameError) as error:
                        codec.decode(frame.name, bytes(damaged), scope)
                    assert error.value.refuse is None


OTHERS = """
protocol: p
checks: {mine: {fold: "(acc * 31 + byte) & 0xFF", initial: 1}}
frames:
  folded:  {body: [{field: a, type: u8}, {check: mine}]}
  raw:     {body: [{field: a, type: u8}, {check: xor8}]}
  warned:  {body: [{field: a, type: u8}, {check: xor8, verify: warn}]}
  digits:  {body: [{field: a, type: u8}, {check: xor8, as: hex}]}
  partly:  {body: [{field: a, type: u8}, {field: b, type: u8}, {check: xor8, over: [b]}]}
  inside:  {body: [{field: a, type: u8}, {check: xor8}, {const: ETX}]}
  maybe:   {body: [{field: a, type: u8}, {check: xor8}, {const: ETX, when: a == 1}]}
  certain: {body: [{field: a, type: u8}, {check: xor8, when: a == 1}]}
  letter:  {body: [{field: a, type: ascii, size: 1}, {check: xor8, when: a == lower(a)}]}
  behind:  {body: [{field: n, type: u8}, {field: t, type: ascii, size: n}, {field: a, type: ascii, size: 1}, {check: xor8, when: a == lower(a)}]}
  large:   {body: [{field: a, type: u8}, {check: sum16, as: hex}]}
  fixed:   {where: {a: [1, 2]}, body: [{field: b, type: u8}, {field: a, type: u8}, {check: xor8}]}
  refused: {where: {a: [1, 2]}, body: [{field: b, type: u8, range: 0..9, refuse: 1}, {field: a, type: u8}, {check: xor8}]}
  wrapped: {body: [{const: 10}, {wrap: {escape: 10}, of: [{field: a, type: u8}]}, {const: 10 03}, {check: xor8}]}
"""


def test_what_it_leaves_to_the_codec(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(OTHERS, encoding="utf-8")
    frames = load_protocol(path).frames
    found = [name for name, frame in frames.items() if intact_of(frame) is not None]
    assert found == ["raw", "digits", "inside", "fixed", "refused"]


def test_bytes_at_fixed_places_and_digits(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(OTHERS, encoding="utf-8")
    frames = load_protocol(path).frames
    fixed, digits, refused, inside = (intact_of(frames[name]) for name in ("fixed", "digits", "refused", "inside"))
    assert fixed and digits and refused and inside
    assert inside(b"\xab\xab\x03") and not inside(b"\xab\xaa\x03")
    assert refused(b"\x0a\x03\x09"), "it is refused for what comes before"
    assert fixed(b"\x09\x02\x0b") and not fixed(b"\x09\x03\x0a") and not fixed(b"\x09\x02\x0a")
    assert digits(b"\xab" + b"aB") and not digits(b"\xab" + b"AC")


def test_a_check_code_before_what_fills_a_frame_up_is_not_at_its_end() -> None:
    text = (
        "protocol: p\nframes: {f: {body: [{field: n, type: u8}, {data: d, size: n}, {check: sum8}], size: 6, fill: 2A}}"
    )
    codec = compile_protocol(load_protocol_text(text, "p"))
    intact, data = intact_of(codec.protocol.frames["f"]), codec.encode("f", {"n": 1, "d": b"a"})
    assert data == b"\x01a\x62***"
    assert intact is None or intact(data)


@pytest.mark.parametrize("name", ["modbus-rtu", "ge-rtu"])
def test_sizes_told_by_one_byte_are_those_that_measuring_finds(name: str) -> None:
    protocol = load_protocol(name)
    codec, choose, sized_count, counts = compile_protocol(protocol), Random(1), 0, 0
    names = Scope(protocol)
    for info in table_of(protocol, codec).infos.values():
        at, sizes, counted, most = info.sizes
        for byte, size in enumerate(sizes if info.guesses else ()):
            for length in (at + 1, 4, 8, 30, 300):
                raw = bytearray(choose.randbytes(length))
                raw[at] = byte
                found = info.extent(raw, 0, length, names)
                if size is not None and counted[byte]:
                    size = size + raw[counted[byte]] if counted[byte] < length else None
                    counts += 1
                if size is not None and size > most:
                    assert found in (codec.LOST, length - size)
                elif size is not None and size < 0:
                    assert found == (codec.QUIET if length <= -size else codec.LOST)
                elif size is not None:
                    assert found == (size if size <= length else length - size)
                sized_count += size is not None
    assert sized_count > 256
    assert counts > 0 or name != "modbus-rtu"
