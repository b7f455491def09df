"""Frames of a protocol inside constructs of the user's own: bare, nested, built, parsed, sized, and their errors."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import construct
import pytest
import shipped
from spread import spread

import framekit
from framekit.codec.ambiguity import sample_context
from framekit.codec.codec import compile_protocol
from framekit.codec.construct import CompiledFrame
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol

SCALE = """
protocol: weigh
params: {site: {type: number, default: 7}}
frames:
  ask:
    body:
      - const: STX
      - {field: station, type: dec, size: 2}
      - {check: xor8}
  answer:
    body:
      - const: 01
      - {length: n, of: d, type: u8}
      - {data: d, size: n}
      - {check: sum8}
  line:
    body: [{field: text, type: ascii, end: CR}]
  rest:
    body: [{const: 05}, {data: d, size: rest}]
  tagged:
    body: [{field: a, type: u8, is: site}, {field: b, type: u8}]
"""


@pytest.fixture
def weigh(tmp_path: Path) -> framekit.Protocol:
    file = tmp_path / "weigh.yaml"
    file.write_text(SCALE)
    return framekit.load(file)


def test_bare_in_struct_array_and_greedy_range(weigh: framekit.Protocol) -> None:
    ask, answer = weigh.construct("ask"), weigh.construct("answer")
    record = construct.Struct("ask" / ask, "answers" / construct.Array(2, answer), "after" / construct.Int8ub)
    values = {"ask": {"station": 12}, "answers": [{"d": b"xyz"}, {"d": b""}], "after": 9}
    data = record.build(values)
    found = record.parse(data)
    assert (found.ask.station, [answer.d for answer in found.answers], found.after) == (12, [b"xyz", b""], 9)
    many = construct.GreedyRange(answer)
    assert [record.d for record in many.parse(many.build([{"d": bytes(n)} for n in range(40)]))] == [
        bytes(n) for n in range(40)
    ]
    assert [line.text for line in construct.GreedyRange(weigh.construct("line")).parse(b"a\rbc\r\rrest")] == [
        "a",
        "bc",
        "",
    ]


def test_the_stream_stands_behind_the_frame(weigh: framekit.Protocol) -> None:
    stream = io.BytesIO(b"\x01\x02ab\xc6\x01\x00\x01tail")
    answer = weigh.construct("answer")
    assert answer.parse_stream(stream).d == b"ab"
    assert answer.parse_stream(stream).d == b""
    assert stream.read() == b"tail"


def test_a_frame_that_only_silence_ends_takes_the_rest(weigh: framekit.Protocol) -> None:
    rest = weigh.construct("rest")
    assert rest.parse(b"\x05abc").d == b"abc"
    assert construct.Prefixed(construct.Int8ub, rest).parse(b"\x02\x05a12").d == b"a"


def test_parameters_are_keywords(weigh: framekit.Protocol) -> None:
    tagged = weigh.construct("tagged")
    assert tagged.build({"b": 1}) == b"\x07\x01"
    assert tagged.build({"b": 1}, site=9) == b"\x09\x01"
    assert construct.Struct("t" / tagged).parse(b"\x09\x02", site=9).t.b == 2


def test_sizes_of_frames_that_never_vary(weigh: framekit.Protocol) -> None:
    assert weigh.construct("ask").sizeof() == 4
    assert construct.Struct("two" / construct.Array(2, weigh.construct("ask"))).sizeof() == 8
    with pytest.raises(construct.SizeofError, match="the size of frame 'answer' varies"):
        weigh.construct("answer").sizeof()


def test_errors_are_those_of_construct_and_of_framekit(weigh: framekit.Protocol) -> None:
    ask = weigh.construct("ask")
    good = ask.build({"station": 12})
    with pytest.raises(framekit.FrameError, match="check at byte 3") as wrong:
        ask.parse(good[:-1] + b"\x00")
    assert isinstance(wrong.value, construct.ConstructError)
    assert (wrong.value.cause, wrong.value.fields["station"]) == ("check", 12)
    with pytest.raises(framekit.EncodeError, match="station") as refused:
        construct.Struct("ask" / ask).build({"ask": {}})
    assert isinstance(refused.value, construct.ConstructError)
    either = construct.Select("ask" / ask, "bytes" / construct.GreedyBytes)
    assert either.parse(good).station == 12
    assert either.parse(b"zz") == b"zz"
    with pytest.raises(framekit.FrameError, match="short"):
        ask.parse(good[:-1])
    with pytest.raises(framekit.RequestError, match=r"no frame .asks"):
        weigh.construct("asks")


@pytest.mark.parametrize("name", spread(shipped.PROTOCOLS, 8, 3))
def test_shipped_frames_parse_and_build_among_other_things(name: str) -> None:
    """Build every sample of every frame, and parse it between other data; `rest` ends with its region."""
    protocol = load_protocol(name)
    codec = compile_protocol(protocol)
    sampler = Sampler(codec, sample_context(protocol))
    for frame in protocol.frames:
        one = CompiledFrame(codec, protocol.frames, frame, lambda _: sampler.context)
        boxed = construct.Struct("before" / construct.Int8ub, "one" / construct.Prefixed(construct.Int16ub, one))
        for sample in sampler.samples(frame):
            assert one.build(sample.values) == sample.data
            assert one.parse(sample.data) == sample.read
            record = boxed.parse(b"\x07" + len(sample.data).to_bytes(2, "big") + sample.data + b"behind")
            assert record.one == sample.read
            with contextlib.suppress(construct.SizeofError):
                assert one.sizeof() == len(sample.data)
            length = codec.measure(frame, sample.data + b"\xffbehind", ctx=sampler.context)
            if length == len(sample.data):
                stream = io.BytesIO(sample.data + b"\xffbehind")
                assert one.parse_stream(stream) == sample.read
                assert stream.read() == b"\xffbehind"
