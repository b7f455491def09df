"""Generated modules for users: they run without framekit, are readable, and are reproducible."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from small_protocol import small_protocol
from spread import spread

import framekit
from framekit.codec import codec as keeping
from framekit.codec import errors
from framekit.codec.codec import compile_protocol
from framekit.codec.python.generate import generate_source
from framekit.codec.python.source import broken
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.frames import Layout
from framekit.definition.sources import shipped_definitions

SHIPPED = [
    path.stem
    for path in shipped_definitions()
    if re.search(r"^(protocol|application):", path.read_text(encoding="utf-8"), re.MULTILINE)
]

BODY = (
    "[{field: station, type: u8}, {field: function, type: u8, is: 3}, {length: bytes, type: u8, of: [values]}, "
    "{data: values, size: bytes}, {check: crc16-modbus, order: little}]"
)

SCRIPT = """
import importlib.util, json, sys
sys.path.insert(0, sys.argv[1])
assert importlib.util.find_spec("framekit") is None
import frames
data = frames.encode_f({"station": 1, "values": b"\\x12\\x34"})
found = {"bytes": data.hex(), "values": repr(frames.decode_f(data))}
found["size"] = frames.measure_f(data + b"x", 0, len(data) + 1)
try:
    frames.FRAMES["f"].decode(data[:-1] + b"!")
except frames.FrameError as error:
    found["fault"] = [error.cause, error.segment, error.offset, str(error)]
try:
    frames.encode_f({"station": 300, "values": b""})
except frames.EncodeError as error:
    found["refused"] = [error.field, str(error)]
found["foreign"] = sorted(name for name in sys.modules if name.startswith("framekit"))
print(json.dumps(found))
"""


def test_a_module_runs_where_framekit_is_not(tmp_path: Path) -> None:
    (tmp_path / "frames.py").write_text(generate_source(small_protocol(BODY)), encoding="utf-8")
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    ran = subprocess.run(
        [sys.executable, "-I", "-S", "-W", "error", str(tmp_path / "script.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found["bytes"] == "0103021234b533"
    assert found["values"] == "{'station': 1, 'function': 3, 'bytes': 2, 'values': b'\\x124'}"
    assert found["size"] == 7
    assert found["fault"][:3] == ["check", "check", 5]
    assert found["refused"] == ["station", "'station' is 300, more than 255"]
    assert found["foreign"] == []


def test_inside_framekit_there_is_one_kind_of_error() -> None:
    codec = compile_protocol(small_protocol(BODY))
    with pytest.raises(errors.FrameError):
        codec.decode("f", b"")
    with pytest.raises(errors.EncodeError):
        codec.encode("f", {})
    assert codec.module.FrameError is errors.FrameError
    assert "class FrameError" not in generate_source(small_protocol(BODY), standalone=False)


def test_the_text_is_the_same_every_time() -> None:
    """`tests/golden` compares the modules of all shipped protocols with those of other processes."""
    for name in ("third-party-plc", "modbus-rtu", "ccm"):
        assert generate_source(load_protocol(name)) == generate_source(load_protocol(name))


@pytest.mark.parametrize("name", spread(SHIPPED, 6, 5))
def test_shipped_definitions_make_clean_modules(name: str) -> None:
    source = generate_source(load_protocol(name))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tree = ast.parse(source)
        compile(tree, name, "exec")
    assert ast.get_docstring(tree)
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    frames = [node for node in functions if node.name.startswith(("encode_", "decode_", "measure_", "diagnose_"))]
    assert all(ast.get_docstring(node) for node in frames)
    assert all(len(line) <= 160 or '"' in line for line in source.splitlines())
    assert not any(line != line.rstrip() for line in source.splitlines())
    assert "framekit" not in "".join(line for line in source.splitlines() if "import" in line)


def test_the_header_says_where_it_comes_from() -> None:
    text = ast.get_docstring(ast.parse(generate_source(load_protocol("third-party-plc")))) or ""
    assert framekit.__version__ in text
    assert "third-party-plc.yaml" in text
    assert "encode_wr_req(values)" in text


def test_names_of_all_kinds_become_identifiers() -> None:
    body = (
        "[{field: class, type: u8}, {field: len, type: u8}, {field: ctx, type: u8}, {field: at, type: u8}, "
        "{field: Struct, type: u8}, {field: struct, type: u8}, {field: encode_f, type: u8}, {field: values, type: u8}, "
        "{field: frame, type: u16}, {field: n, type: u8}, {data: data, size: n}, {check: sum8}]"
    )
    codec = compile_protocol(small_protocol(body))
    values = {
        name: place
        for place, name in enumerate(["class", "len", "ctx", "at", "Struct", "struct", "encode_f", "values", "frame"])
    }
    data = codec.encode("f", {**values, "n": 2, "data": b"ab"})
    assert codec.decode("f", data) == {**values, "n": 2, "data": b"ab"}
    assert codec.measure("f", data) == len(data)


def test_names_of_frames_that_clash_with_each_other_and_with_helpers() -> None:
    frames = "frames:\n  A.B: {body: [{const: 01}]}\n  A_B: {body: [{const: 02}]}\n  a-b: {body: [{const: 03}]}\n"
    codec = compile_protocol(
        small_protocol(
            "[{inner: i, of: g}]",
            "groups: {g: {from: client}}",
            frames + "  one: {group: g, body: [{const: 04}]}\n  first: {group: g, body: [{const: 05}]}",
        )
    )
    for name, data in {"A.B": b"\x01", "A_B": b"\x02", "a-b": b"\x03", "one": b"\x04", "first": b"\x05"}.items():
        assert codec.encode(name, {}) == data
    assert codec.decode("f", b"\x05") == {"i": {"first": {}}}
    assert codec.encode("f", {"i": {"one": {}}}) == b"\x04"


def test_a_protocol_is_compiled_once() -> None:
    protocol = small_protocol(BODY)
    assert compile_protocol(protocol) is compile_protocol(protocol)


def test_defaults_hold_what_frames_ask_for_and_nothing_else() -> None:
    protocol = small_protocol(
        "[{field: a, type: u8, build: start}, {data: d, size: announced}, {require: a < most}]",
        "params: {most: {type: number, default: 9}, unused: {type: number, default: 1}}",
        "state: {start: {scope: line, type: u8, initial: 2}, announced: {scope: line, type: u16}}",
        keys="announces: {announced: a}",
    )
    codec = compile_protocol(protocol)
    assert codec.defaults == {"announced": None, "most": 9, "start": 2}
    assert codec.encode("f", {"d": b"xy"}) == b"\x02xy"
    with pytest.raises(KeyError, match="'other' has no default"):
        codec.defaults["other"]


def test_layouts_are_codecs_of_their_own() -> None:
    protocol = small_protocol("[{field: x, type: u8}, {data: d, size: rest}]")
    frame = protocol.frames["f"]
    hanging = small_protocol("[{const: 01, name: c}, {check: sum8, over: [c]}]").frames["f"].segments[1:]
    layouts = {
        "pair": Layout(name="pair", segments=frame.segments, at=frame.at),
        "hanging": Layout(name="hanging", segments=hanging, at=frame.at),
    }
    codec = compile_protocol(replace(protocol, layouts=layouts))
    encode, decode = codec.layouts["pair"]
    assert encode({"x": 1, "d": b"ab"}, {}) == b"\x01ab"
    assert decode(b"\x01ab", {}) == {"x": 1, "d": b"ab"}
    assert "hanging" not in codec.layouts, "its check covers what is not in it"


def test_a_layout_with_a_list_that_knows_its_last_item_is_a_codec_of_its_own() -> None:
    chain = small_protocol(
        "[{repeat: a, until: more == 0, of: [{bits: {more: 7, v: 0-6}, of: u8, is: {more: not last}}]}]"
    )
    frame = chain.frames["f"]
    codec = compile_protocol(
        replace(chain, layouts={"chain": Layout(name="chain", segments=frame.segments, at=frame.at)})
    )
    encode, decode = codec.layouts["chain"]
    assert encode({"a": [{"v": 1}, {"v": 2}]}, {}) == b"\x81\x02"
    assert decode(b"\x81\x02", {}) == {"a": [{"more": 1, "v": 1}, {"more": 0, "v": 2}]}


def test_many_bits_are_broken_too() -> None:
    names = [f"a_rather_long_name_{number}" for number in range(11)]
    bits = " | ".join(f"{name} << {place}" for place, name in enumerate(names))
    lines = ["result = sum((", *broken(f"    {bits},"), "))"]
    assert all(len(line) <= 160 for line in lines)
    scope: dict[str, int] = dict.fromkeys(names, 1)
    exec("\n".join(lines), scope)
    assert scope["result"] == 0x7FF


@pytest.mark.parametrize("word", ["and", "or"])
@pytest.mark.parametrize("first", ["alpha", "(alpha)"])
def test_long_conditions_are_broken_where_python_allows_it(first: str, word: str) -> None:
    names = ["alpha", *(f"a_rather_long_name_{number}" for number in range(8))]
    condition = f" {word} ".join([first, *names[1:]])
    source = "\n".join([*broken(f"if {condition}:"), "    result = 1"])
    expected = all if word == "and" else any
    for values in ([1] * 9, [0] * 9, [1] * 8 + [0], [0] * 8 + [1]):
        scope: dict[str, int] = dict(zip(names, values, strict=True)) | {"result": 0}
        exec(source, scope)
        assert scope["result"] == int(expected(values))


@pytest.mark.parametrize(
    "text",
    [
        "1 if alpha and beta or gamma else 2",
        "alpha and beta or gamma if gamma or alpha and beta else beta",
        "1 if alpha else 2 if beta or gamma and alpha else 3 if gamma else 4",
        "(1 if alpha else 2) | (4 if beta and gamma else 8)",
        "alpha or (beta if gamma else alpha) and beta",
    ],
)
@pytest.mark.parametrize("lead", ["result = ", 'values["result"] = ', "return "])
def test_long_choices_mean_the_same_on_several_lines(text: str, lead: str) -> None:
    """A conditional expression binds weaker than `or` and `and`, so operands must not extend into it."""
    longer = {
        name: f"{name}_with_a_name_that_makes_each_of_these_lines_too_long" for name in ("alpha", "beta", "gamma")
    }
    for name, long in longer.items():
        text = text.replace(name, long)
    lines = broken(f"    {lead}{text}")
    assert len(lines) > 1
    for place in range(8):
        known = {long: place >> bit & 1 for bit, long in enumerate(longer.values())}
        scope: dict[str, Any] = dict(known)
        body = "\n".join(["def f():", "    values = {}", *lines, "    return result" if lead[0] == "r" else ""])
        if lead.startswith("values"):
            body += "    return values['result']"
        exec(body, scope)
        assert scope["f"]() == eval(text, dict(known)), text


def test_no_more_codecs_are_kept_than_definitions(monkeypatch: pytest.MonkeyPatch) -> None:
    """A codec dropped from the cache is compiled again on demand; the last used codec stays."""
    monkeypatch.setattr(keeping, "MOST_KEPT", 4)
    monkeypatch.setattr(keeping, "_compiled", {})
    protocols = [small_protocol("[{field: a, type: u8}]") for _ in range(5)]
    first, second, *others = protocols
    codecs = [compile_protocol(text) for text in (first, second, *others[:-1])]
    assert compile_protocol(first) is codecs[0]
    compile_protocol(others[-1])
    assert compile_protocol(first) is codecs[0]
    assert compile_protocol(second) is not codecs[1]


def test_names_that_begin_with_a_digit() -> None:
    body = "[{field: a, type: u8, values: {1: on}}, {count: n, type: u8, of: l}, {repeat: l, times: n, of: u16}]"
    outer = "[{inner: i, of: 9g}, {check: sum8}]"
    frames = (
        f"  7th: {{body: {outer}}}\n  1.5: {{group: 9g, body: {body}}}\n  1_5: {{group: 9g, body: [{{const: 01}}]}}"
    )
    text = f"protocol: 3com\norder: big\ngroups: {{9g: {{}}}}\nframes:\n{frames}"
    names: dict[str, Any] = {"__name__": "alone"}
    exec(compile(generate_source(load_protocol_text(text, "3com")), "alone", "exec"), names)
    data = names["encode_7th"]({"i": {"1.5": {"a": "on", "l": [2]}}})
    assert data == names["build_7th_with_1_5"](a="on", l=[2]) == b"\1\1\0\2\4"
    assert names["decode_7th"](data) == {"i": {"1.5": {"a": 1, "n": 1, "l": [2]}}}
