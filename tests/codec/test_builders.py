"""Builders compared with encoders: the same bytes and the same errors, for every shipped protocol."""

from __future__ import annotations

import inspect
from array import array
from collections.abc import Iterator, Mapping
from functools import partial
from random import Random
from typing import Any

import pytest
from random_bodies import RandomBody
from shipped import APPLICATIONS, PROTOCOLS
from spread import spread

from framekit.codec.ambiguity import sample_context
from framekit.codec.codec import Builders, compile_protocol
from framekit.codec.errors import EncodeError
from framekit.codec.python.flat import Parameters, inner_frames, levels_of, write_plain_builder
from framekit.codec.python.generate import MOST_BUILDERS, BuilderModules, builder_name, generate_source, normal_protocol
from framekit.codec.python.module import Module
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.protocol import Protocol

CARRIED = ("pccc", "pccc-admin", "ge-service", "modbus-pdu", "ge-rtu-pdu")
"""Applications whose frames are contained in shipped protocols, and built there."""
STRANGE: tuple[Any, ...] = (
    -1, 0, 255, 256, 300, 70_000, 1 << 40, 1.5, "", "no such name", b"", b"x" * 300, [], [1] * 300, [256], [-1, 70_000],
    (1, 2), {1: 2}, {}, "AB", True, range(2), bytearray(b"ab"), memoryview(b"abcd").cast("H"), array("H", [1, 2]),
)  # fmt: skip


class Both:
    """The builders and the encoders of a protocol."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.codec = compile_protocol(protocol)
        self.context = sample_context(protocol)
        self.builders = Builders(self.codec, self.context)
        self.module = Module(normal_protocol(protocol))
        self.frames = self.module.protocol.frames
        self.sampler = Sampler(self.codec, self.context)
        self.random = Random(protocol.name)
        self.known: dict[tuple[str, ...], Parameters] = {}

    def chains(self) -> Iterator[tuple[str, ...]]:
        """Yield every outermost frame, alone and with each chain of inner frames."""
        inside = {name for frame in self.frames.values() for name in inner_frames(frame)}
        for name in self.frames:
            if name not in inside:
                yield from self._from(name)

    def _from(self, *frames: str) -> Iterator[tuple[str, ...]]:
        yield frames
        for name in inner_frames(self.frames[frames[-1]]):
            yield from self._from(*frames, name)

    def nested(self, frames: tuple[str, ...]) -> Iterator[dict[str, Any]]:
        """Yield values of the frames, nested like the frames."""
        levels = levels_of(self.frames, frames)
        for sample in self.sampler.samples(frames[-1], count=3):
            values = dict(sample.values)
            for level, inside in reversed(list(zip(levels, frames[1:], strict=False))):
                outer = next(iter(self.sampler.samples(level.frame.name)), None)
                if outer is None or level.inner is None:
                    return
                values = {**outer.values, level.inner.name: {inside: values}}
            yield values

    def parameters(self, frames: tuple[str, ...]) -> Parameters:
        if frames not in self.known:
            self.known[frames] = Parameters(self.module, levels_of(self.frames, frames))
        return self.known[frames]

    def keywords(self, frames: tuple[str, ...], values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the nested values by parameter name."""
        parameters = self.parameters(frames)
        found: dict[str, Any] = {}
        for depth, level in enumerate(parameters.levels):
            for name, value in values.items():
                if (depth, name) in parameters.names:  # others are constants, which samples may hold
                    found[parameters.names[depth, name]] = value
            if level.inner is not None:
                values = values[level.inner.name][frames[depth + 1]]
        return found

    def build(self, frames: tuple[str, ...]) -> Any:
        return self.builders.builder(*frames)

    def compare(self, frames: tuple[str, ...]) -> int:
        """Compare both; return how often both gave bytes."""
        build, found = self.build(frames), 0
        for values in self.nested(frames):
            keywords = self.keywords(frames, values)
            wanted = result(lambda: self.codec.encode(frames[0], values, self.context))  # noqa: B023
            assert result(lambda: build(**keywords)) == wanted  # noqa: B023
            if not found:
                for name in keywords:
                    self.compare_spoilt(frames, keywords, name)
            found += isinstance(wanted, bytes)
        return found

    def compare_spoilt(self, frames: tuple[str, ...], keywords: dict[str, Any], name: str) -> None:
        build = self.build(frames)
        for strange in self.random.sample(STRANGE, 5):
            spoilt = {**keywords, name: strange}
            wanted = result(lambda: self.codec.encode(frames[0], self.as_nested(frames, spoilt), self.context))  # noqa: B023
            assert result(lambda: build(**spoilt)) == wanted, (frames, spoilt)  # noqa: B023

    def as_nested(self, frames: tuple[str, ...], keywords: dict[str, Any]) -> dict[str, Any]:
        parameters = self.parameters(frames)
        whole = values = dict[str, Any]()
        for depth, level in enumerate(parameters.levels):
            values |= {
                parameter.key: keywords[parameter.name]
                for parameter in parameters.all
                if parameter.depth == depth and parameter.name in keywords
            }
            if level.inner is not None:
                inside: dict[str, Any] = {}
                values[level.inner.name] = {frames[depth + 1]: inside}
                values = inside
        return whole

    def is_plain(self, frames: tuple[str, ...]) -> bool:
        levels = levels_of(self.frames, frames)
        return write_plain_builder(self.module, "build", "encode", levels, "ctx") is not None


def result(build: Any) -> Any:
    try:
        return build()
    except ValueError as error:  # a module that stands alone has an EncodeError of its own
        return str(error), vars(error)


@pytest.mark.parametrize("name", spread([*PROTOCOLS, *(name for name in APPLICATIONS if name not in CARRIED)], 6, 1))
def test_shipped_frames_are_built_alike(name: str) -> None:
    both = Both(load_protocol(name))
    built = {frames: both.compare(frames) for frames in both.chains()}
    assert any(built.values()) or not both.frames
    assert all(built[frames] for frames in built if both.is_plain(frames))


def test_protocols_use_it() -> None:
    both = Both(load_protocol("modbus-rtu"))
    plain = [frames for frames in both.chains() if both.is_plain(frames)]
    assert len(plain) == 28
    assert all(len(frames) == 2 for frames in plain)


# ---- parameters ---------------------------------------------------------------------------------------------


def protocol_of(body: str, *frames: str, more: str = "") -> Protocol:
    """Return a protocol with the frame `f` of this body, and frames named `x0`, `x1` …"""
    lines = ["protocol: built", "order: big", *([more] if more else []), "groups:", "  inside: {}", "frames:"]
    lines.append(f"  f: {{body: [{body}]}}")
    lines += [f"  x{place}: {{group: inside, {frame}}}" for place, frame in enumerate(frames)]
    return load_protocol_text("\n".join(lines), "built")


def builders(protocol: Protocol) -> Builders:
    codec = compile_protocol(protocol)
    return Builders(codec, codec.defaults)


def signature(protocol: Protocol, *frames: str) -> str:
    return str(inspect.signature(builders(protocol).builder(*frames)))


INNER = "{inner: pdu, of: inside}"


@pytest.mark.parametrize(
    ("body", "wanted"),
    [
        (
            "{const: 02}, {field: a, type: u8}, {length: n, type: u8, of: [d]}, {data: d, size: n}",
            "*, a: int, d: bytes",
        ),
        ("{field: a, type: u8, is: 3}, {field: b, type: ascii, size: 2}, {check: sum8}", "*, b: str"),
        ("{field: a, type: u8, default: 4}, {field: b, type: f32}", "*, a: int = 4, b: float"),
        ("{field: a, type: u8, values: {1: one, 2: two}, default: \"'two'\"}", "*, a: int | str = 2"),
        ("{field: a, type: u8, build: b + 1}, {field: b, type: u8}", "*, a: int | None = None, b: int"),
        ("{field: a, type: u8}, {field: b, type: u8, when: a == 1}", "*, a: int, b: int | None = None"),
        ("{bits: {high: 7, low: 0-3}, of: u8}", "*, high: int = 0, low: int = 0"),
        ("{count: n, type: u8, of: l}, {repeat: l, times: n, of: u16}", "*, l: list[int] | tuple[int, ...]"),
        ("{field: a, type: u8}, {data: d, size: 4, pad: 00}", "*, a: int, d: bytes = b''"),
        ("{const: 02}", ""),
        (
            "{field: class, type: u8}, {field: ctx, type: u8}, {field: ctx_, type: u8}",
            "*, class_: int, ctx_: int, ctx__: int",
        ),
        (
            "{field: Len, type: u8}, {field: len, type: u8}, {data: values, size: rest}",
            "*, Len: int, len: int, values: bytes",
        ),
    ],
)
def test_what_a_caller_gives(body: str, wanted: str) -> None:
    assert signature(protocol_of(body), "f") == f"({wanted}) -> bytes"


KIND = "body: [{field: kind, type: u8, is: 1}, {field: a, type: u16}]"


def test_one_name_in_two_frames() -> None:
    protocol = protocol_of(f"{{field: a, type: u8}}, {INNER}", KIND)
    found = builders(protocol)
    assert str(inspect.signature(found.builder("f", "x0"))) == "(*, a: int, x0_a: int) -> bytes"
    assert found.builder("f", "x0")(a=1, x0_a=2).hex() == "01010002"
    with pytest.raises(EncodeError, match=r"^'a' is 70000, more than 65535$") as caught:
        found.builder("f", "x0")(a=1, x0_a=70_000)
    assert caught.value.field == "pdu.x0.a"


def test_frames_in_frames_in_frames() -> None:
    middle = "body: [{field: b, type: u8}, {inner: deep, of: deepest}, {field: c, type: u8}]"
    more = "groups: {inside: {}, deepest: {}}"
    text = [
        "protocol: built",
        "order: big",
        more,
        "frames:",
        f"  f: {{body: [{{field: a, type: u8}}, {INNER}, {{check: sum8}}]}}",
    ]
    text += [f"  m: {{group: inside, {middle}}}", "  d: {group: deepest, body: [{field: e, type: u16}]}"]
    protocol = load_protocol_text("\n".join(text), "built")
    found, codec = builders(protocol), compile_protocol(protocol)
    assert (found.inside("f"), found.inside("m"), found.inside("d")) == (("m",), ("d",), ())
    values = {"a": 1, "pdu": {"m": {"b": 2, "deep": {"d": {"e": 3}}, "c": 4}}}
    data = codec.encode("f", values)
    assert Both(protocol).is_plain(("f", "m", "d"))
    assert found.builder("f", "m", "d")(a=1, b=2, e=3, c=4) == data
    assert found.builder("f", "m")(a=1, b=2, deep={"d": {"e": 3}}, c=4) == data
    assert found.builder("f")(a=1, pdu=values["pdu"]) == data
    assert found.builder("d")(e=3) == b"\0\3"
    with pytest.raises(KeyError):
        found.builder("f", "d")


def test_a_builder_is_made_once() -> None:
    found = builders(protocol_of(f"{{field: a, type: u8}}, {INNER}", KIND))
    assert found.builder("f", "x0") is found.builder("f", "x0")


def test_what_is_left_out_and_what_is_none() -> None:
    body = "{field: a, type: u8}, {field: b, type: u8, when: a == 1}, {field: c, type: u8, build: a + 1}"
    found = builders(protocol_of(body)).builder("f")
    assert found(a=1, b=2) == b"\1\2\2"
    assert found(a=2, b=None, c=None) == b"\2\3"
    with pytest.raises(EncodeError, match=r"^'b' is missing$"):
        found(a=1)
    with pytest.raises(EncodeError, match="'b' is not part of this frame, but 2 is given"):
        found(a=2, b=2)
    with pytest.raises(TypeError, match="missing 1 required keyword-only argument: 'a'"):
        found(b=2)


@pytest.mark.parametrize("count", [0, 1, 5, 6, 7, 300])
def test_lists_up_to_the_longest_frame(count: int) -> None:
    keys = "protocol: built\norder: big\nframes:\n  f: {max: 16, body: [{length: n, type: u16, of: [l]}, "
    protocol = load_protocol_text(f"{keys}{{repeat: l, times: n // 2, of: u16}}, {{check: crc16-modbus}}]}}", "built")
    found = builders(protocol).builder("f")
    codec = compile_protocol(protocol)
    for values in (list(range(count)), tuple(range(count)), bytes(count), range(count)):
        wanted = result(lambda: codec.encode("f", {"l": values}))  # noqa: B023
        assert result(lambda: found(l=values)) == wanted  # noqa: B023
        assert isinstance(wanted, bytes) == (count <= 6 and isinstance(values, (list, tuple)))


@pytest.mark.parametrize("of", ["u8", "u24"])
def test_lists_of_what_no_struct_packs(of: str) -> None:
    body = f"[{{count: n, type: u8, of: l}}, {{repeat: l, times: n, of: {of}}}]"
    both = Both(load_protocol_text(f"protocol: built\norder: big\nframes:\n  f: {{max: 12, body: {body}}}", "built"))
    assert both.is_plain(("f",))
    for count in (0, 3, 4, 11, 12, 300):
        values = [7] * count
        assert result(lambda: both.builders.builder("f")(l=values)) == result(  # noqa: B023
            lambda: both.codec.encode("f", {"l": values}, both.context)  # noqa: B023
        )


def test_what_the_docstring_says() -> None:
    body = (
        "{field: a, type: u8, range: 1..16, doc: how many}, {field: m, type: u8, values: {1: on, 2: off}}, "
        "{field: t, type: u16, unit: 10 ms}, {check: sum8}"
    )
    assert inspect.getdoc(builders(protocol_of(body)).builder("f")) == (
        "Build the frame `f` of single values. Raises EncodeError.\n\n"
        "a u8 · m u8 · t u16 big · check sum8\n\n"
        "`a`: how many; 1..16\n`m`: 1 (on), 2 (off)\n`t`: whole nanoseconds, a multiple of 10 ms"
    )


def test_frames_that_depend_on_the_context() -> None:
    body = "{field: a, type: u8}, {require: a <= limit}"
    codec = compile_protocol(protocol_of(body, more="params: {limit: {type: number, default: 3}}"))
    few, many = Builders(codec, {"limit": 3}).builder("f"), Builders(codec, {"limit": 30}).builder("f")
    assert many(a=20) == b"\x14"
    with pytest.raises(EncodeError, match="it must hold that a <= limit"):
        few(a=20)


def test_what_is_given_counts_before_what_the_context_says() -> None:
    body = "{field: a, type: u8, build: limit if limit > 3 else 1}"
    codec = compile_protocol(protocol_of(body, more="params: {limit: {type: number, default: 3}}"))
    build = Builders(codec, {"limit": 30}).builder("f")
    assert (build(), build(a=2)) == (b"\x1e", b"\2")


@pytest.mark.parametrize(
    "body", ["{data: d, size: rest}, {check: sum8}", "{data: d, size: rest}", "{data: d, size: 2}"]
)
def test_the_result_is_bytes(body: str) -> None:
    codec = compile_protocol(protocol_of(body))
    for data in (codec.encode("f", {"d": bytearray(b"ab")}), Builders(codec, {}).builder("f")(d=bytearray(b"ab"))):
        assert type(data) is bytes


def test_texts_hold_what_is_worked_out() -> None:
    protocol = protocol_of("{field: n, type: ascii, size: 2, is: a}, {field: a, type: ascii, size: 4}, {check: sum8}")
    build, codec = builders(protocol).builder("f"), compile_protocol(protocol)
    for give in (lambda: build(a="abcd"), lambda: codec.encode("f", {"a": "abcd"})):
        with pytest.raises(EncodeError, match="do not fit into this frame"):
            give()


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("{length: n, type: hex, size: 2, of: [d]}, {data: d, size: n}", "'d' has a length of 300, more than 255"),
        ("{const: 02}, {length: n, type: hex, size: 2, of: [d]}, {data: d, size: n}", "'d' has a length of 300"),
        ("{field: n, type: hex, size: 2, is: len(d)}, {data: d, size: n}", "the values do not fit into this frame"),
        ("{length: n, type: hex, size: 2, of: [d], plus: -301}, {data: d, size: n + 301}", "do not fit into this"),
    ],
)
def test_hex_digits_hold_what_is_worked_out(body: str, told: str) -> None:
    protocol = protocol_of(body)
    for build in (builders(protocol).builder("f"), lambda d: compile_protocol(protocol).encode("f", {"d": d})):
        with pytest.raises(EncodeError, match=told):
            build(d=bytes(300))


# ---- definitions made up at random --------------------------------------------------------------------------

AROUND = (
    "{field: st, type: u8}, {inner: pdu, of: inside}, {check: sum8}",
    "{length: len, type: u16, of: [st, pdu]}, {field: st, type: u8}, {inner: pdu, of: inside, size: len - 1}",
    "{length: len, type: u8, of: [pdu], unit: 2}, {inner: pdu, of: inside, size: 2 * len}, {field: st, type: u8}",
    "{const: DLE STX}, {wrap: {escape: DLE}, of: [{inner: pdu, of: inside}]}, {const: DLE ETX}, "
    "{field: st, type: u8}, {check: crc16-arc, over: [pdu], order: little}",
    "{const: 3A}, {wrap: hex, of: [{field: st, type: u8}, {inner: pdu, of: inside}, {check: lrc}]}, {const: 0D 0A}",
)
"""The declarations around a random frame."""


@pytest.mark.parametrize("seed", range(30))
def test_random_frames_are_built_alike(seed: int) -> None:
    body, around = RandomBody(seed), AROUND[seed % len(AROUND)]
    sections = "\n".join(body.sections)
    frames = f"  f: {{max: 40, body: [{around}]}}\n  x: {{group: inside, body: {body.text}}}"
    text = f"protocol: built\norder: big\n{sections}\ngroups:\n  inside: {{}}\nframes:\n{frames}\n"
    both = Both(load_protocol_text(text, "built"))
    for values in ({"st": 1, "pdu": {"x": body.values}}, body.values):
        rows = ("f", "x") if values is not body.values else ("x",)
        keywords, build = both.keywords(rows, values), both.build(rows)
        wanted = result(lambda: both.codec.encode(rows[0], values, both.context))  # noqa: B023
        assert result(lambda: build(**keywords)) == wanted  # noqa: B023
        for name in keywords:
            both.compare_spoilt(rows, keywords, name)


@pytest.mark.parametrize("values", [array("H", [1, 2]), memoryview(b"\1\0\2\0").cast("H"), memoryview(b"\1\0\2\0")])
def test_what_holds_bytes_counts_by_its_bytes(values: Any) -> None:
    body = "{length: n, type: u8, of: [b, d]}, {field: b, type: bytes, size: 4}, {data: d, size: n - 4}"
    both = Both(protocol_of(body))
    wanted = b"\x08" + 2 * bytes(values)
    assert both.codec.encode("f", {"b": values, "d": values}) == both.build(("f",))(b=values, d=values) == wanted


def test_a_parameter_called_type_hides_nothing() -> None:
    body = "{field: type, type: u8}, {count: n, type: u8, of: l}, {repeat: l, times: n, of: u16}, {data: d, size: rest}"
    name, source = BuilderModules(protocol_of(body)).source(["f"])
    names: dict[str, Any] = {"__name__": "alone", "ctx": {}, "EncodeError": EncodeError}
    exec(compile(source, "alone", "exec"), names)  # without the encoder, which handles values that do not fit
    assert names[name](type=1, l=[2, 3], d=b"d") == b"\1\2\0\2\0\3d"


# ---- modules that stand alone -------------------------------------------------------------------------------


class Alone(Both):
    """The builders of a stand-alone module."""

    def __init__(self, protocol: Protocol) -> None:
        super().__init__(protocol)
        self.names: dict[str, Any] = {"__name__": "alone"}
        exec(compile(generate_source(protocol), "alone", "exec"), self.names)

    def build(self, frames: tuple[str, ...]) -> Any:
        name = builder_name(frames)
        if name not in self.names:
            assert not self.is_plain(frames) or inner_frames(self.frames[frames[-1]])
            return None
        return partial(self.names[name], ctx=self.context)


@pytest.mark.parametrize("name", ["modbus-rtu", "ccm", "snp-x", "mldp", "third-party-plc", "modbus-pdu"])
def test_modules_that_stand_alone_have_them(name: str) -> None:
    alone = Alone(load_protocol(name))
    built = {frames: alone.compare(frames) for frames in alone.chains() if alone.build(frames) is not None}
    assert built
    assert all(built.values())


def test_defaults_of_a_module_that_stands_alone() -> None:
    alone = Alone(load_protocol("modbus-rtu")).names
    build = alone["build_reply_adu_with_read_holding_reply"]
    assert build(station=17, values=b"\0\1") == bytes.fromhex("11030200 01b8 47")
    with pytest.raises(alone["EncodeError"], match=r"^'station' is 300, more than 255$"):
        build(station=300, values=b"")
    assert "= build_request_adu_with_read_coils(…)" in alone["__doc__"]


@pytest.mark.parametrize(
    ("body", "is_plain"),
    [
        ("{field: b, type: u8, when: a == 1}", True),
        ("{optional: [{field: b, type: u8}]}", False),
        ("{choose: a, cases: {1: [{field: b, type: u8}]}, else: []}", False),
        ("{count: n, type: u8, of: l}, {repeat: l, times: n, of: [{field: x, type: u8}]}", False),
    ],
)
def test_what_modules_that_stand_alone_have_no_builders_for(body: str, is_plain: bool) -> None:
    assert ("\ndef build_f(" in generate_source(protocol_of(f"{{field: a, type: u8}}, {body}"))) == is_plain


def test_names_of_builders_that_are_taken() -> None:
    frames = (
        "frames:\n  hex: {body: [{field: a, type: u8}]}\n  A.B: {body: [{const: 01}]}\n  a-b: {body: [{const: 02}]}"
    )
    names = Alone(load_protocol_text(f"protocol: built\n{frames}", "built")).names
    found = [name for name in names if name.startswith("build_")]
    assert "build_a_b" in found and "build_a_b_2" in found
    assert [names[name]() for name in ("build_a_b", "build_a_b_2")] == [b"\1", b"\2"]
    assert names["build_hex_2"](a=7) == b"\7"


def test_there_is_a_bound() -> None:
    frames = [f"body: [{{field: kind, type: u8, is: {number}}}]" for number in range(MOST_BUILDERS + 5)]
    source = generate_source(protocol_of(f"{{field: a, type: u8}}, {INNER}", *frames))
    assert source.count("\ndef build_f_with_x") == MOST_BUILDERS
