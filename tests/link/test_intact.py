"""The quick look at check codes: it never passes over a frame that the codec would take, or have refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.samples import Sampler
from framekit.definition.load import load_protocol
from framekit.link.intact import intact_of
from framekit.link.scope import Scope

FRAMES = Path(__file__).parents[2] / "frames"
NAMES = sorted(path.name.split(".")[0] for path in FRAMES.glob("*.yaml") if path.name.count(".") == 1)


def test_some_shipped_frames_have_it() -> None:
    found = {
        name for name in NAMES for frame in load_protocol(name).frames.values() if intact_of(frame) is not None
    }  # fmt: skip
    assert {"modbus-rtu", "ge-rtu"} <= found
    assert not {"mldp", "third-party-plc"} & found, "their check codes are digits, or not always there"


@pytest.mark.parametrize("name", NAMES)
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
  certain: {body: [{field: a, type: u8}, {check: xor8, when: a == 1}]}
  wrapped: {body: [{const: 10}, {wrap: {escape: 10}, of: [{field: a, type: u8}]}, {const: 10 03}, {check: xor8}]}
"""


def test_what_it_leaves_to_the_codec(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(OTHERS, encoding="utf-8")
    frames = load_protocol(path).frames
    assert [name for name, frame in frames.items() if intact_of(frame) is not None] == ["raw"]
