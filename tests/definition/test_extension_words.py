"""Words that extension programs register: each word has one owner, which may register it again.

No other may replace it.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import pytest

from framekit.codec import checks
from framekit.codec.codec import Builders, compile_protocol
from framekit.codec.extend import add_check, add_type
from framekit.codec.kinds import SegmentKind, register
from framekit.codec.python import forms
from framekit.codec.python import module as generated
from framekit.codec.python.generate import generate_source
from framekit.codec.python.registry import KINDS as CODES
from framekit.definition import brought, schema, wire_types
from framekit.definition.keys import IDENTIFIER, Form, key
from framekit.definition.kinds.base import KINDS, Segment
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model import checks as methods
from framekit.definition.model.procedure import ADDED_KEYS
from framekit.definition.model.segments import Field
from framekit.definition.problems import DefinitionError
from framekit.link.sequences import writing
from framekit.run.triggers import TRIGGERS, add_trigger

PLACES = (
    *(wire_types.TYPES, wire_types.TYPE_KINDS, forms.WIRE_FORMS, methods.ADDED, checks.FUNCTIONS, KINDS, CODES),
    *(ADDED_KEYS, writing.ADDED_FUNCTIONS, TRIGGERS, brought._WORDS),
    *(brought.MODULES, generated._INLINED, writing.STEP_KEYS, methods.CHECK_KINDS),
)
"""The registries that extension programs add to."""

Bring = Callable[..., ModuleType]


@pytest.fixture
def bring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bring]:
    """Import a module with a name and a text, again if necessary; restore all registries afterwards."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before, modules = [place.copy() for place in PLACES], set(sys.modules)

    def imported(name: str, text: str) -> ModuleType:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        importlib.invalidate_caches()
        return importlib.reload(sys.modules[name]) if name in sys.modules else importlib.import_module(name)

    yield imported
    for place, kept in zip(PLACES, before, strict=True):
        place.clear()  # type: ignore[attr-defined]
        (place.extend if isinstance(place, list) else place.update)(kept)  # type: ignore[attr-defined]
    for name in set(sys.modules) - modules:
        if not name.startswith("framekit"):
            del sys.modules[name]
    for made in (
        schema._schemas,
        schema._validator,
        schema._known_keys,
        generated.inlined_names,
        generated._names_of_added,
    ):
        made.cache_clear()
    for made in (methods.ready_methods, checks.function_of, checks.source_of):
        made.cache_clear()


def parse(raw: bytes) -> int:
    return raw[0]


def build(number: int, size: int) -> bytes:
    return bytes((number,))


def code(data: bytes) -> int:
    return 0


def write(step: writing.StepWriter, value: object) -> None:
    raise AssertionError("nothing is written here")


@dataclass(frozen=True, slots=True, kw_only=True)
class Other(Segment):
    KEY: ClassVar[str] = "data"
    name: str = key("data", IDENTIFIER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Companion(Segment):
    KEY: ClassVar[str] = "size"
    name: str = key("size", IDENTIFIER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Both(Segment):
    KEY: ClassVar[str] = "made_up"
    name: str = key("made_up", IDENTIFIER)
    more: str = key("length", IDENTIFIER)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rubbish(Segment):
    KEY: ClassVar[str] = "made_up"
    name: str = key("made_up", IDENTIFIER._replace(schema={"type": "rubbish"}))


@dataclass(frozen=True, slots=True, kw_only=True)
class Nowhere(Segment):
    KEY: ClassVar[str] = "made_up"
    name: str = key("made_up", IDENTIFIER._replace(schema={"$ref": "common.schema.json#/$defs/nowhere"}))


def kind_of(segment_class: type[Segment]) -> type[SegmentKind[Segment]]:
    return type("MadeUpKind", (SegmentKind,), {"model": segment_class, "__module__": __name__})


RUBBISH = Form({"type": "rubbish"}, IDENTIFIER.read)
OWN = f"has the {{}} already: '{__name__}' can't bring it too – take another word"
WRONG: dict[str, tuple[Callable[[], None], str]] = {
    "type": (lambda: add_type("u16", 2, parse, build, most=9), OWN.format("type 'u16'")),
    "kind of type": (lambda: add_type("digits", 2, parse, build, most=9), OWN.format("type 'digits'")),
    "check": (lambda: add_check("lrc", code), OWN.format("check method 'lrc'")),
    "kind of check": (lambda: add_check("word_sum", code), OWN.format("check method 'word_sum'")),
    "width": (lambda: add_check("made_up", code, width=0), "a check code of 0 bits is not possible: 1 to 128 are"),
    "kind": (lambda: register(kind_of(Other)), OWN.format("key of a segment 'data'")),
    "key of a kind": (lambda: register(kind_of(Companion)), OWN.format("key of a segment 'size'")),
    "kind as a key": (lambda: register(kind_of(Both)), "the key 'length' of 'made_up' is a kind of segment itself"),
    "model": (lambda: register(kind_of(Field)), "'framekit.codec.kinds.field' has a kind of Field already"),
    "schema": (lambda: register(kind_of(Rubbish)), "the schema of 'made_up' is wrong: 'rubbish' is not valid under"),
    "reference": (lambda: register(kind_of(Nowhere)), "refers to 'common.schema.json#/$defs/nowhere', which is not"),
    "step key": (
        lambda: writing.add_step_key("send", IDENTIFIER, "", write, before="set"),
        OWN.format("key of a step 'send'"),
    ),
    "schema of a step key": (
        lambda: writing.add_step_key("made_up", RUBBISH, "", write),
        "the schema of 'made_up' is wrong: 'rubbish' is not valid under",
    ),
    "place of a step key": (
        lambda: writing.add_step_key("made_up", IDENTIFIER, "", write, before="sent"),
        "no step key 'sent' is there to do 'made_up' before it – name another one",
    ),
    "function of steps": (
        lambda: writing.add_step_key("made_up", IDENTIFIER, "", write, len),
        "framekit has the function of steps 'len' already",
    ),
    "trigger": (lambda: add_trigger("every", lambda *_: None, {}), OWN.format("key of a block 'every'")),  # type: ignore[arg-type,return-value]
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_brought_is_refused_and_changes_nothing(bring: Bring, case: str) -> None:
    call, what = WRONG[case]
    before = [place.copy() for place in PLACES]
    with pytest.raises(ValueError) as caught:
        call()
    assert what in str(caught.value)
    assert [place.copy() for place in PLACES] == before
    assert load_protocol("modbus-rtu").name == "modbus-rtu"
    load_protocol_text("protocol: own\nframes:\n  one: {body: [{field: a, type: u16}, {data: d, size: 2}]}\n")


BRINGS_ALL = """
from dataclasses import dataclass
from typing import ClassVar

from framekit.codec.extend import add_check, add_type
from framekit.codec.kinds import SegmentKind, register
from framekit.definition.keys import IDENTIFIER, key
from framekit.definition.kinds.base import Segment
from framekit.link.sequences.writing import add_step_key
from framekit.run.triggers import add_trigger


def parse_made_up(raw):
    return raw[0] ^ MASK


def build_made_up(number, size):
    return bytes((number ^ MASK,))


def code_made_up(data):
    return MASK


def count_made_up(name):
    pass


def write_made_up(step, name):
    step.add("count_made_up()")


def load_made_up(read, node, keys):
    raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeUp(Segment):
    KEY: ClassVar[str] = "made_up_kind"
    name: str = key("made_up_kind", IDENTIFIER)


class MadeUpKind(SegmentKind[MadeUp]):
    model = MadeUp


add_type("made_up", 1, parse_made_up, build_made_up, most=255)
add_check("made_up", code_made_up)
add_step_key("made_up", IDENTIFIER, "", write_made_up, count_made_up, before="set")
add_trigger("made_up", load_made_up, {"type": "string"})
register(MadeUpKind)
""".replace("MASK", "0x11")
USES = "protocol: own\nframes:\n  one: {body: [{field: a, type: made_up}, {check: made_up}]}\n"


def test_a_module_that_is_loaded_again_replaces_what_it_brought(bring: Bring) -> None:
    def encoded() -> bytes:
        return compile_protocol(load_protocol_text(USES)).encode("one", {"a": 1}, {})

    bring("made_up", BRINGS_ALL)
    assert encoded().hex() == "1011"
    keys, modules = len(writing.STEP_KEYS), len(brought.MODULES)
    module = bring("made_up", BRINGS_ALL.replace("0x11", "0x022"))
    assert encoded().hex() == "2322"
    assert (len(writing.STEP_KEYS), len(brought.MODULES)) == (keys, modules)
    assert KINDS["made_up_kind"] is module.MadeUp
    assert writing.ADDED_FUNCTIONS["count_made_up"] is module.count_made_up
    found = schema._schemas()["protocol.schema.json"]["$defs"]["segment"]
    assert sum(form == {"required": ["made_up_kind"]} for form in found["oneOf"]) == 1


@pytest.mark.parametrize("call", ["add_type", "add_check", "add_step_key", "add_trigger", "register"])
def test_a_word_belongs_to_the_module_that_brought_it(bring: Bring, call: str) -> None:
    bring("made_up", BRINGS_ALL)
    begin, line = BRINGS_ALL[: BRINGS_ALL.index("add_type(")], BRINGS_ALL[BRINGS_ALL.index(f"\n{call}(") :]
    with pytest.raises(ValueError, match=r"the module 'made_up' has the .* already: 'other_made_up' can't bring"):
        bring("other_made_up", begin + line.splitlines()[1])


def test_two_functions_of_steps_have_two_names(bring: Bring) -> None:
    bring("made_up", BRINGS_ALL)
    with pytest.raises(ValueError, match="the module 'made_up' has the function of steps 'count_made_up' already"):
        bring("other_made_up", BRINGS_ALL.replace('"made_up', '"other_made_up'))


@pytest.mark.parametrize("word", ["oneOf", "anyOf"])
def test_the_schema_of_a_key_may_leave_a_choice(bring: Bring, word: str) -> None:
    kinds = {word: [{"enum": ["soon", "late"]}, {"type": "array"}]}
    key = 'add_step_key("made_up", IDENTIFIER'
    bring("made_up", BRINGS_ALL.replace(key, f"{key}._replace(schema={kinds})"))
    text = (
        "protocol: own\nframes:\n  one: {body: [{const: 01}]}\n"
        "sequences:\n  main: {steps: [{step: a, made_up: WORD, send: one}]}\n"
        "roles: {client: {lanes: {main: {exchange: main}}}}\n"
    )
    with pytest.raises(DefinitionError, match=r"'made_up' of step 'a' .* is not right"):
        load_protocol_text(text.replace("WORD", "never"))
    load_protocol_text(text.replace("WORD", "soon"))


SAME_NAMES = """
from framekit.codec.extend import add_check, add_type
import zlib


def changed(number, low=0):
    return number ^ 0x11


def parse(raw):
    changes = [changed for low in raw]
    return changes[0](raw[0])


def build(number, size):  # a name that is bound inside is none of the module's
    def inner(xor8):
        return xor8
    return bytes((inner(changed(number)),))


def sum(data):
    return data[0]


def xor8(data):
    return sum(data) + 0x11 + len(zlib.compress(data[:0])) * 0


add_type("made_up", 1, parse, build, most=255)
add_check("made_up", xor8)
"""


def test_functions_of_the_same_name_stay_apart(bring: Bring) -> None:
    bring("made_up", SAME_NAMES)
    bring("other_made_up", SAME_NAMES.replace("0x11", "0x22").replace('"made_up"', '"other"'))
    protocol = load_protocol_text(
        "protocol: own\nframes:\n"
        "  one: {body: [{field: a, type: made_up}, {field: b, type: other}, {check: made_up}]}\n"
        "  two: {body: [{field: a, type: other}, {check: other}, {check: xor8}, {check: sum8}]}\n"
    )
    wanted = {"one": ({"a": 0, "b": 0}, "112222"), "two": ({"a": 0}, "224466cc")}
    codec = compile_protocol(protocol)
    alone: dict[str, Any] = {"__name__": "alone"}
    exec(generate_source(protocol), alone)
    for name, (values, data) in wanted.items():
        assert codec.encode(name, values, {}).hex() == alone["FRAMES"][name].encode(values).hex() == data
        assert (
            codec.decode(name, bytes.fromhex(data), {}) == alone["FRAMES"][name].decode(bytes.fromhex(data)) == values
        )


IMPORTS = """
from functools import total_ordering as xor8
import os.path
from framekit.codec.extend import add_type
from framekit_and_more import first
from operator import neg as turned
from .helpers import changed


@xor8
class Read:
    def __init__(self, number):
        self.number = turned(turned(number))

    def __lt__(self, other):
        return self.number < other.number


def parse(raw):
    return Read(changed(first(raw))).number


def build(number, size):
    return bytes((changed(number),)) + os.path.basename("a/").encode()


add_type("made_up", 1, parse, build, most=255)
"""


def test_what_modules_import_stays_apart_too(bring: Bring, tmp_path: Path) -> None:
    (tmp_path / "framekit_and_more.py").write_text("def first(raw):\n    return raw[0]\n")
    for name, mask, turned in (("made_up", "0x11", "neg"), ("other", "0x22", "inv")):
        (tmp_path / f"{name}_package").mkdir()
        (tmp_path / f"{name}_package" / "helpers.py").write_text(f"def changed(number):\n    return number ^ {mask}\n")
        text = IMPORTS.replace("made_up", name).replace("neg", turned)
        (tmp_path / f"{name}_package" / "types_of.py").write_text(text)
        importlib.import_module(f"{name}_package.types_of")
    protocol = load_protocol_text(
        "protocol: own\nframes:\n  one: {body: [{field: a, type: made_up}, {field: b, type: other}, {check: xor8}]}\n"
    )
    values, data = {"a": 0x01, "b": 0x02}, bytes.fromhex("102030")
    codec, alone = compile_protocol(protocol), dict[str, Any](__name__="alone")
    exec(generate_source(protocol), alone)
    for one in (codec.frames["one"], alone["FRAMES"]["one"]):
        assert one.encode(values, {}) == data and one.decode(data, {}) == values


CLASSES = """
from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar

from framekit.codec.extend import add_type


class Part(IntEnum):
    LOW = 0
    HIGH = 1


@dataclass(frozen=True, slots=True)
class Pair:
    BASE: ClassVar[int] = 256
    parts: list[int] = field(default_factory=list)

    @property
    def number(self) -> int:
        return self.parts[Part.HIGH] * self.BASE + self.parts[Part.LOW]


@dataclasses.dataclass(frozen=True)
class Named(Pair):
    name: str = ""


def parse(raw: bytes) -> int:
    return Named([*raw]).number


def build(number: int, size: int) -> bytes:
    return bytes(Named([number % Pair.BASE, number // Pair.BASE]).parts)


add_type("made_up", 2, parse, build, most=65535)
"""


def test_classes_made_by_decorators_are_carried_along(
    bring: Bring, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bring("made_up", CLASSES)
    protocol = load_protocol_text("protocol: own\nframes:\n  one: {body: [{field: a, type: made_up}, {check: xor8}]}\n")
    values, data = {"a": 0x0102}, bytes.fromhex("020103")
    codec = compile_protocol(protocol)
    assert codec.encode("one", values, {}) == data and codec.decode("one", data, {}) == values
    assert Builders(codec, {}).builder("one")(**values) == data
    (tmp_path / "made_alone.py").write_text(generate_source(protocol))
    monkeypatch.syspath_prepend(str(tmp_path))
    alone = importlib.import_module("made_alone").FRAMES["one"]
    assert alone.encode(values) == data and alone.decode(data) == values


KIND = """
from dataclasses import dataclass
from typing import ClassVar

from framekit.codec.kinds import SegmentKind, register
from framekit.codec.python.function import between
from framekit.definition.keys import IDENTIFIER, key
from framekit.definition.kinds.base import Segment
from framekit.definition.model.segments import exactly


@dataclass(frozen=True, slots=True, kw_only=True)
class MadeUp(Segment):
    KEY: ClassVar[str] = "made_up"
    name: str = key("made_up", IDENTIFIER)

    def sizes(self, of_frame):
        return exactly(1)


def swap(raw):
    return raw[0] ^ 0x11


class MadeUpKind(SegmentKind[MadeUp]):
    model = MadeUp

    def read(self, r, item, segment, after):
        local = r.function.local(segment.name, item.scope)
        first, last = r.take(item, "1")
        r.function.add(f"{local} = {r.module.function(swap)}({between(r.buffer, first, last)})")
        r.declare(item, segment.name, local, sized=False)

    def bytes_text(self, w, segment, scope):
        return "bytes(1)"

    def diagnose(self, d, segment, scope, behind):
        d.out.add(f"n.field({d.named(segment)}, 1, {d.module.function(swap)})")


register(MadeUpKind)
"""


def test_two_kinds_may_have_helpers_of_the_same_name(bring: Bring) -> None:
    bring("made_up", KIND)
    bring("other_made_up", KIND.replace("0x11", "0x22").replace('"made_up"', '"other"'))
    body = "[{made_up: a}, {other: b}, {data: c, size: 2, swap: 2}]"
    codec = compile_protocol(load_protocol_text(f"protocol: own\nframes:\n  one: {{from: server, body: {body}}}\n"))
    assert codec.decode("one", bytes(2) + b"ab", {}) == {"a": 0x11, "b": 0x22, "c": b"ba"}


def test_a_function_without_a_name_of_its_own_is_refused() -> None:
    what = "define it there, outside of functions and classes"
    with pytest.raises(ValueError, match=what):
        add_type("made_up", 1, lambda raw: 0, build, most=9)
    with pytest.raises(ValueError, match=what):
        add_check("made_up", lambda data: 0)


def test_helpers_of_framekit_alone_are_asked_for_by_name() -> None:
    module = generated.Module(load_protocol_text("protocol: own\nframes:\n  one: {body: [{const: 01}]}\n"))
    assert module.function("swap") == "swap"
    with pytest.raises(ValueError, match="framekit has no helper 'parse' – give the function itself, not its name"):
        module.function("parse")
    with pytest.raises(ValueError, match="nothing has brought the function 'parse' of"):
        module.function(parse)
