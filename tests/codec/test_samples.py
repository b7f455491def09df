"""Samples: every frame of the shipped protocols has samples, always the same, and they decode to their values."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import shipped

from framekit.api.check import check_file
from framekit.codec.ambiguity import ANNOUNCED, SampleLine, sample_context
from framekit.codec.codec import compile_protocol
from framekit.codec.plain import PlainValues
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.protocol import Protocol


def sampler_of(protocol: Protocol) -> Sampler:
    return Sampler(compile_protocol(protocol), sample_context(protocol))


@pytest.mark.parametrize("name", shipped.PROTOCOLS)
def test_every_shipped_frame_has_samples_that_read_back(name: str) -> None:
    protocol = load_protocol(name)
    sampler = sampler_of(protocol)
    plain = PlainValues(protocol)
    for frame in protocol.frames:
        samples = sampler.samples(frame)
        assert samples, frame
        for sample in samples:
            read = sampler.codec.decode(frame, sample.data, sampler.context)
            assert read == sample.read
            assert sample.values.keys() <= read.keys()
            shown = json.loads(json.dumps(plain.to_plain(frame, read)))
            again = sampler.codec.encode(frame, plain.from_plain(frame, shown), sampler.context)
            assert again == sample.data, "what decode shows is taken by encode"
    assert sampler.in_vain == []


def test_samples_are_the_same_every_time_and_differ_from_each_other() -> None:
    protocol = load_protocol("mldp")
    one, other = sampler_of(protocol).samples("write_individual"), sampler_of(protocol).samples("write_individual")
    assert [sample.data for sample in one] == [sample.data for sample in other]
    assert len({sample.data for sample in one}) == len(one) == 8


def test_values_respect_ranges_tables_sizes_and_conditions() -> None:
    protocol = load_protocol_text(
        """
        protocol: t
        tables: {names: {3: three, 9: nine}}
        frames:
          f:
            body:
              - {field: n, type: u16, range: 500..503}
              - {field: k, type: u8, values: names, only: values}
              - {field: t, type: u8, unit: 10 ms, range: 20 ms..40 ms}
              - {length: size, type: u8, of: [text], range: 2..4}
              - {field: text, type: ascii, size: size}
              - {require: "text[0] == '%' and n != 501"}
              - {count: items, type: u8, of: list, range: 1..2}
              - {repeat: list, times: items, of: [{bits: {low: 0-3}, of: u8}, {data: d, size: low, when: low < 4}]}
              - {choose: k, cases: {three: [{field: x, type: u8}], nine: [{data: x, size: 2}]}}
        """
    )
    samples = sampler_of(protocol).samples("f")
    assert len(samples) >= 4
    for read in (sample.read for sample in samples):
        assert read["n"] in (500, 502, 503)
        assert read["k"] in (3, 9)
        assert read["t"] in (20_000_000, 30_000_000, 40_000_000)
        assert read["text"].startswith("%") and 2 <= len(read["text"]) <= 4
        assert 1 <= len(read["list"]) <= 2
        assert isinstance(read["x"], int if read["k"] == 3 else bytes)


def test_inner_frames_and_announced_sizes() -> None:
    protocol = load_protocol_text(
        """
        protocol: t
        state: {next_size: {type: u16}}
        groups: {pdu: {from: none}}
        frames:
          a: {group: pdu, body: [{const: 01}, {field: n, type: u8}]}
          b: {group: pdu, body: [{const: 02}]}
          outer:
            body:
              - {const: STX}
              - {inner: pdu, of: pdu}
              - {wrap: {escape: DLE}, of: [{data: d, size: rest}]}
              - {const: DLE ETX}
          header: {body: [{const: SOH}, {field: size, type: u16}], announces: {next_size: size}}
          block: {body: [{const: SYN}, {data: bytes, size: next_size}]}
        """
    )
    sampler = sampler_of(protocol)
    assert {next(iter(sample.read["pdu"])) for sample in sampler.samples("outer")} == {"a", "b"}
    assert {len(sample.read["bytes"]) for sample in sampler.samples("block")} == {ANNOUNCED}


def test_what_cannot_be_made_has_no_samples() -> None:
    protocol = load_protocol_text("protocol: t\nframes:\n  f: {body: [{field: n, type: u8}, {require: n * n == 7}]}\n")
    assert sampler_of(protocol).samples("f") == ()


def test_the_context_has_a_station_a_line_and_defaults_that_stand_on_others() -> None:
    context = sample_context(load_protocol("modbus-rtu"))
    assert context["station"] == context["own"] == 1
    assert isinstance(context["line"], SampleLine)
    assert context["frame_gap"] == context["line"].chars(35, 10)
    named = load_protocol_text("protocol: t\nstation: {type: text, size: 3}\nframes: {f: {body: [{const: 00}]}}\n")
    assert sample_context(named)["station"] == "AAA"
    ranged = load_protocol_text("protocol: t\nstation: {range: 5..9}\nframes: {f: {body: [{const: 00}]}}\n")
    assert sample_context(ranged)["station"] == 5


RECORDS = """\
protocol: records
layouts:
  hop: [{bits: {s: 1-7, last: 0}, of: u8, build: {last: 0}}]
frames:
  ui:
    body:
      - {include: hop, as: one}
      - {include: hop, as: two, when: one.last == 0}
      - {field: more, type: u8, when: two.last == 0}
      - {bits: {long: 0}, of: u8, build: {long: len(text) > 2}}
      - {field: hint, type: u8, when: long}
      - {data: text, size: rest}
  never: {body: [{field: a, type: u8}, {require: a > 5 and a < 3}]}
"""


def test_conditions_see_what_is_computed_in_records_and_what_follows_them() -> None:
    sampler = sampler_of(load_protocol_text(RECORDS, "made_up"))
    samples = sampler.samples("ui")
    assert len(samples) == 8
    assert all("more" in sample.values for sample in samples), "the last bits are 0"
    assert {"hint" in sample.values for sample in samples} == {True, False}
    assert sampler.samples("never") == () and sampler.in_vain == ["never"]


HELD = """
protocol: held
frames:
  A: {body: [{const: 41}, {field: place, type: ascii, end: 20}, {require: "'.H' in upper(place)"}]}
  B: {body: [{const: 42}, {field: place, type: ascii, size: 6}, {require: "'DM' in place and '.' not in place"}]}
  C:
    body:
      - {const: 43}
      - {field: n, type: u8}
      - {field: place, type: ascii, size: n}
      - {require: "'xyz' in lower(place) and n < 9"}
"""


def test_texts_that_conditions_ask_for_are_found() -> None:
    sampler = sampler_of(load_protocol_text(HELD, "held"))
    for frame, held in (("A", ".H"), ("B", "DM"), ("C", "xyz")):
        samples = sampler.samples(frame)
        assert len(samples) == 8 and all(held in sample.values["place"] for sample in samples)
    assert not sampler.in_vain


def test_frames_that_vectors_build_are_not_told(tmp_path: Path) -> None:
    file = tmp_path / "hard.yaml"
    body = '[{field: t, type: ascii, size: 4}, {require: "number(t, 16) == 0x12AB"}]'
    file.write_text(f"protocol: hard\nframes:\n  A: {{body: {body}}}\n")
    (problem,) = check_file(str(file)).problems
    assert "no values were found that 'A' can be built of" in problem.what
    vectors = tmp_path / "hard.vectors.yaml"
    vectors.write_text("vectors: hard\nframes: [{frame: A, values: {t: 12AB}, bytes: 31 32 41 42}]\n")
    assert check_file(str(file)).problems == [] and check_file(str(vectors)).problems == []
    vectors.write_text("vectors: [hard\n")
    assert len(check_file(str(file)).problems) == 1


@pytest.mark.parametrize(
    "text",
    [
        "frames: {f: {body: [{bits: {e: 7, code: 0-6}, of: u8}, {require: code == 0}]}}",
        "frames: {f: {body: [{bits: {e: 7, code: 0-6}, of: u8}, {require: 'code in [70, 71] and e != 1'}]}}",
        "tables: {letters: {65: 'A', 66: 'B'}}\n"
        "frames: {f: {body: [{const: C0}, {field: c, type: u8, build: 'find(letters, call[0])'},"
        " {value: call, read: 'letters[c]'}]}}",
    ],
)
def test_samples_meet_conditions_on_bits_and_values_as_they_are_read(text: str) -> None:
    assert len(sampler_of(load_protocol_text(f"protocol: p\n{text}", "p")).samples("f")) > 1
