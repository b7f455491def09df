"""Exported Kaitai files, compiled by Kaitai, read the values that framekit reads: field by field, of every vector."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
import yaml
from extras.kaitai.kaitai_world import Compared, Reader, needs_compiler, reader_of, readers_of
from shipped import vectors_of
from strategies import base_context
from test_construct_vectors import plain_values

from framekit.codec.codec import compile_protocol
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import load_protocol
from framekit.definition.sources import shipped_definitions
from framekit.extras.kaitai.generate import generate_kaitai

QUICK = ("modbus-rtu", "snp-x")
VECTORS = [path.name.removesuffix(".vectors.yaml") for path in shipped_definitions("*.vectors.yaml")]


def compare_vectors(reader: Reader) -> Compared:
    """Compare every published frame of a protocol, read by both."""
    protocol, found = reader.protocol, Compared()
    codec = compile_protocol(protocol)
    for vector in vectors_of(protocol.name).frames:
        context = base_context(protocol) | plain_values(protocol, vector)
        if vector.frame is None or vector.expect is not None:
            continue
        data = vector.wire.exact
        if data is None:  # compute its check code
            data = codec.encode(
                vector.frame, PlainValues(protocol).from_plain(vector.frame, vector.values or {}), context
            )
        fields = codec.frames[vector.frame].decode(data, context)
        reader.compare_frame(vector.frame, data, context, fields, found)
    return found


OTHERS = [name for name in VECTORS if name not in QUICK]
PIECES = 6


@needs_compiler
@pytest.mark.parametrize(
    "names",
    [QUICK, *(pytest.param(OTHERS[at::PIECES], marks=pytest.mark.long) for at in range(PIECES))],
    ids=" ".join,
)
def test_vectors_are_read_as_framekit_reads_them(names: Sequence[str]) -> None:
    for name, reader in zip(names, readers_of([load_protocol(name) for name in names]), strict=True):
        found = compare_vectors(reader)
        assert found.differences == [], name
        assert found.agreed or found.left_out, name


def test_what_kaitai_does_not_say_is_told_with_its_place() -> None:
    made = generate_kaitai(load_protocol("scpi"))
    messages = {problem.what for problem in made.left_out}
    assert any(what.startswith("frame 'line' is left out") for what in messages)
    assert "line" in made.types and "line" not in made.frames
    assert any("the check code" in problem.what for problem in generate_kaitai(load_protocol("modbus-rtu")).left_out)
    for problem in made.left_out:
        assert f"{problem.at.line}:{problem.at.column}: {problem.what}" in made.text


HOSTILE = """
protocol: odd
about: "title: [x] # \\u2028 \\e[31m"
receiver: {gap: 1 s}
frames:
  class:
    doc: "- id: injected\\n  type: u1"
    body:
      - {field: _io, type: u8, values: {1: "name: x", 2: "a\\"b", 3: class, 4: CLASS, 5: "*/ x(); /*"}}
      - {field: Self, type: u16, doc: "'''\\u0085: {"}
      - {data: e, size: 0, doc: "\\"\\"\\" + 1 / 0 + \\"\\"\\" **//\\n\\\\u002a/ ]##"}
      - {field: self, type: u16}
      - {field: t, type: bytes, size: 2, is: "h'22 5C'"}
"""


@needs_compiler
def test_names_and_texts_of_a_file_stay_names_and_texts(tmp_path: Path) -> None:
    (tmp_path / "odd.yaml").write_text(HOSTILE.replace("_io", "n_io"), "utf-8")
    protocol = load_protocol(tmp_path / "odd.yaml")
    reader = reader_of(protocol)
    read = reader.read("class", bytes.fromhex("04 0001 0002 225C"), {})
    assert (read.n_io.name, read.self_, read.self_2, read.t) == ("class_2", 1, 2, b'"\\')
    file = yaml.safe_load(reader.file.text)
    assert [*file["types"]] == ["class_", "unexpected"]
    assert file["enums"]["n_io"][5]["doc"] == "* / x(); / *"
    assert file["types"]["class_"]["seq"][2]["doc"] == "''' + 1 / 0 + ''' * * / / /u002a/ ] # #"
