"""The loader: drafts of every kind load, definitions are merged as specified, all problems are reported together."""

from __future__ import annotations

from pathlib import Path

import pytest
import shipped
from spread import spread

from framekit.definition.expression import Expression, Text, walk
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.segments import Bits, Check, Const, Data, Field, Inner, Length, Wrap
from framekit.definition.problems import DefinitionError


@pytest.mark.parametrize("name", spread(shipped.PROTOCOLS + shipped.APPLICATIONS, 3, 2))
def test_shipped_definitions_load_without_a_warning(name: str) -> None:
    protocol = load_protocol(name)
    assert protocol.name == name
    assert protocol.warnings == ()


def test_where_is_written_into_the_fields() -> None:
    frame = load_protocol("mldp").frames["read_individual"]
    constants = {part.name: part.constants for part in frame.head if isinstance(part, Field)}
    assert constants == {"station": None, "command": ("r", "R"), "type": ("SS",)}


def test_an_application_is_carried_by_its_links() -> None:
    for link in ("modbus-rtu", "modbus-ascii", "modbus-tcp"):
        protocol = load_protocol(link)
        assert protocol.frames["read_holding"].inner
        assert not protocol.frames["request_adu"].inner
        assert protocol.services["read"][0].areas == ("coil",)
    rtu = load_protocol("modbus-rtu").frames["request_adu"]
    inner = rtu.body[0]
    assert isinstance(inner, Inner)
    assert inner.frames[-1] == "other_request", "frames that exist to be refused are tried last"


def test_a_protocol_adds_frames_to_groups_of_its_application(tmp_path: Path) -> None:
    (tmp_path / "boxes.yaml").write_text(
        "application: boxes\ngroups: {box: {from: client, head: [{field: kind, type: u8}]}}\n"
        "frames: {small: {group: box, where: {kind: 1}}, other: {group: box, body: [], refuse: 5}}\n"
    )
    (tmp_path / "link.yaml").write_text(
        "protocol: link\napplication: boxes\n"
        "frames:\n  large: {group: box, where: {kind: 2}, body: [{field: x, type: u16}]}\n"
        "  message: {from: client, body: [{const: STX}, {inner: box, of: boxes.box}]}\n"
    )
    protocol = load_protocol(tmp_path / "link.yaml")
    assert [name for name, frame in protocol.frames.items() if not frame.inner] == ["message"]
    inner = protocol.frames["message"].body[1]
    assert isinstance(inner, Inner)
    assert inner.frames == ("large", "small", "other")


def test_extends_takes_over_what_is_not_given_again() -> None:
    protocol = load_protocol("mldp")
    assert set(protocol.roles) == {"client", "server"}
    assert protocol.sequences["exchange"].steps[0].receive is not None
    assert protocol.receiver.resync == "next_start"


def test_bytes_are_hex_and_numbers_decimal() -> None:
    protocol = load_protocol_text(
        """
        protocol: t
        frames:
          f:
            body:
              - const: 10 DLE ff
              - {field: a, type: u8, is: 10}
              - {skip: 2, fill: 0d 0A}
              - {data: d, size: 010}
        """
    )
    const, field, skip, data = protocol.frames["f"].body
    assert isinstance(const, Const) and const.data == b"\x10\x10\xff"
    assert isinstance(field, Field) and field.is_ is not None and field.is_.text == "10"
    assert skip.fill == b"\r\n"  # type: ignore[attr-defined]
    assert isinstance(data, Data) and data.size == 10


def test_includes_carry_their_condition_and_code() -> None:
    protocol = load_protocol_text(
        """
        protocol: t
        layouts:
          pair: [{field: a, type: u8}, {field: b, type: u8, when: a > 1}]
        frames:
          f: {body: [{field: k, type: u8}, {include: pair, when: k == 1, refuse: 7}, {include: pair, as: second}]}
        """
    )
    _, first, second, record = protocol.frames["f"].body
    assert first.when is not None and first.when.text == "k == 1"
    assert second.when is not None and second.when.text == "(k == 1) and (a > 1)"
    assert (first.refuse, second.refuse) == (7, 7)
    assert record.name == "second"


def test_names_that_segments_mention_are_written_out() -> None:
    protocol = load_protocol_text(
        """
        protocol: t
        frames:
          f:
            body:
              - {const: 01, name: start}
              - {length: n, type: u8, of: [body]}
              - {bits: {x: 0, y: 1-3}, of: u8}
              - {wrap: {escape: DLE}, name: w, of: [{data: d, size: rest}]}
              - {const: DLE}
              - {check: crc16-arc, over: [start, x, w], order: little}
              - {check: sum8, over: 1..here}
        """
    )
    start, length, bits, wrap, _, crc, total = protocol.frames["f"].body
    assert isinstance(length, Length) and length.of[0] == "start" and len(length.of) == 7
    assert isinstance(bits, Bits) and isinstance(wrap, Wrap)
    assert isinstance(crc, Check) and crc.covers == ("start", bits.name, "w") and crc.size == 2
    assert isinstance(total, Check) and total.covers == (("n", "here"),)
    assert isinstance(start, Const)


def test_a_quoted_name_beside_values_is_a_number() -> None:
    protocol = load_protocol_text(
        """
        protocol: t
        frames:
          f:
            body:
              - {field: kind, type: u8, values: {1: short, 2: long}}
              - {data: d, size: "4 if kind == 'long' else 2"}
        """
    )
    data = protocol.frames["f"].body[1]
    assert isinstance(data, Data)
    assert isinstance(data.size, Expression)
    assert not any(isinstance(node, Text) for node in walk(data.size.root))


def test_names_of_a_request_are_those_of_its_row() -> None:
    """Two frames have a `mode` with different names of values; `request.mode` is that of the row's request."""
    protocol = load_protocol_text(
        """
        protocol: t
        frames:
          log: {body: [{const: 01}, {field: mode, type: u8, values: {2: login, 4: bye}}]}
          clock: {body: [{const: 02}, {field: mode, type: u8, values: {1: both, 2: date}}]}
          done: {body: [{const: 06}]}
        services:
          logon: [{request: {log: {mode: 2}}, reply: {done: {}}, refuse: [{when: request.mode == 'bye', code: 1}]}]
          set: [{request: {clock: {mode: 2}}, reply: {done: {}}, refuse: [{when: request.mode == 'date', code: 1}]}]
        """
    )
    for service in ("logon", "set"):
        refusal = protocol.services[service][0].refuse[0]
        assert not any(isinstance(node, Text) for node in walk(refusal.when.root))


def test_only_bytes_have_a_size() -> None:
    with pytest.raises(DefinitionError, match="a variable of type text has no size"):
        load_protocol_text("protocol: t\nstate: {a: {type: text, size: 4}}\nframes: {f: {body: [{const: 01}]}}\n")


def test_all_problems_come_at_once(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(
        "protocol: bad\n"
        "frames:\n"
        "  a: {group: nowhere, body: [{const: 0}]}\n"
        "  b: {body: [{field: x, type: u9}, {data: d, size: y}]}\n"
        "sequences:\n"
        "  s:\n"
        "    steps:\n"
        "      - {step: one, send: a, then: two}\n",
        encoding="utf-8",
    )
    with pytest.raises(DefinitionError) as caught:
        load_protocol(path)
    lines = {problem.at.line for problem in caught.value.problems}
    assert {3, 4, 8} <= lines
    assert "'u9'" in str(caught.value)


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "~/x", "a/../../b"])
def test_no_file_outside_is_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(f"protocol: p\nextends: '{name}'\n", encoding="utf-8")
    with pytest.raises(DefinitionError, match=r"leaves the definition's folder|is not a name"):
        load_protocol(path)


def test_circles_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("protocol: a\nextends: b\n", encoding="utf-8")
    (tmp_path / "b.yaml").write_text("protocol: b\nextends: a\n", encoding="utf-8")
    with pytest.raises(DefinitionError, match="in a circle: a → b → a"):
        load_protocol(tmp_path / "a.yaml")


def test_an_include_circle_is_refused() -> None:
    with pytest.raises(DefinitionError, match="includes itself"):
        load_protocol_text("protocol: t\nlayouts:\n  a: [{include: a}]\nframes:\n  f: {body: [{include: a}]}\n")


@pytest.mark.parametrize("written", ["lib", "lib.yaml", "lib, lib"])
def test_a_used_file_brings_only_what_is_mentioned(tmp_path: Path, written: str) -> None:
    (tmp_path / "lib.yaml").write_text(
        "application: lib\n"
        "params: {depth: {type: number, default: 3}, other: {type: number, default: 4}}\n"
        "layouts:\n  part: [{data: d, size: depth}]\n",
        encoding="utf-8",
    )
    (tmp_path / "p.yaml").write_text(
        f"protocol: p\nuses: [{written}]\nframes:\n  f: {{body: [{{include: lib.part}}]}}\n", encoding="utf-8"
    )
    protocol = load_protocol(tmp_path / "p.yaml")
    assert set(protocol.params) == {"depth"}
    file = tmp_path / "p.yaml"
    file.write_text(file.read_text("utf-8").replace("lib.part", "part"), encoding="utf-8")
    with pytest.raises(DefinitionError, match=r"there is no layout 'part' – write lib\.part"):
        load_protocol(file)


def test_a_definition_is_loaded_once_and_again_when_a_file_of_it_changes(tmp_path: Path) -> None:
    base, file = tmp_path / "base.yaml", tmp_path / "own.yaml"
    base.write_text("protocol: base\nframes:\n  f: {body: [{const: 01}]}\n", encoding="utf-8")
    file.write_text("protocol: own\nextends: base\n", encoding="utf-8")
    first = load_protocol(file)
    assert load_protocol(file) is first
    base.write_text("protocol: base\nframes:\n  g: {body: [{const: 01}]}\n", encoding="utf-8")
    second = load_protocol(file)
    assert (list(first.frames), list(second.frames)) == (["f"], ["g"])
    base.write_text("protocol: base\nframes: 5\n", encoding="utf-8")
    for _ in range(2):
        with pytest.raises(DefinitionError):
            load_protocol(file)


def test_a_definition_is_loaded_again_when_a_name_in_it_means_another_file(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text("protocol: own\nextends: scale-base\n", encoding="utf-8")
    (tmp_path / "scale-base.yaml").write_text("protocol: a\nframes:\n  f: {body: [{const: 01}]}\n", encoding="utf-8")
    assert list(load_protocol(file).frames) == ["f"]
    (tmp_path / "scale-base").write_text("protocol: b\nframes:\n  g: {body: [{const: 01}]}\n", encoding="utf-8")
    assert list(load_protocol(file).frames) == ["g"]
