"""Text of a file never becomes code: hostile text in any key gives the same source as harmless text.

The keys come from `schemas/protocol.schema.json`, so a new key is tested at once. If the loader accepts the text,
source is generated, inside framekit and stand-alone, and its syntax tree is compared without its strings.
"""

from __future__ import annotations

import ast
import json
import keyword
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cache
from inspect import signature
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from segment_cases import SECTIONS
from spread import spread

from framekit.codec.codec import Builders, compile_protocol
from framekit.codec.python import generate
from framekit.codec.python.generate import BuilderModules, generate_source
from framekit.codec.python.module import _INLINED
from framekit.codec.python.source import Code, Source, quoted, text_source
from framekit.definition.expression import parse_expression
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Mapping, Node, Scalar, read_text
from framekit.definition.problems import DefinitionError, Position
from framekit.definition.schema import _schemas, _validator
from framekit.definition.sources import shipped_definitions
from framekit.link.frame_table import FrameTable
from framekit.link.sequences.compiler import sequence_source
from framekit.link.values import Names, compile_expression

PASTED = {module.__name__.rpartition(".")[2] for module in _INLINED}
"""Inlined modules; their f-strings are error messages."""
HOSTILE = (
    '"""; boom(); """\n\'\'\'; boom(); \'\'\'\n\\"""{boom()}{{%s#\\\n'
    "\u2028\x85\\N{BULLET}(boom).x boom()\n\"; boom(); '"
)
SHORT = '"""{x}\\\'#'
TEXTS = {text: ("harmless" * 20)[: len(text)] for text in (HOSTILE, SHORT)}
"""Hostile text → harmless text; the second pair is tried if the first is refused."""
LARGE = 3000
"""Size of a definition that is tried with one text and one module only, since it takes a second."""
READ = {"name", "about", "kind", "params", "state", "tables", "layouts", "frames", "sources", "receiver"}
"""Sections of a definition that generators read."""
NOT_READ = {
    "roles", "sessions", "services", "areas", "addresses", "errors", "server", "commands",
    "station", "line",
}  # fmt: skip
"""Sections that generators do not read; `tests/link/test_hostile_services.py` tests the sections that services read."""


FOLDED = """
protocol: folded
checks: {own: {fold: acc ^ byte, initial: 0}}
frames: {A: {body: [{field: x, type: u8}, {check: own}]}}
"""
SMALL = """
protocol: small
params: {p: {type: text, default: "'a'"}}
state: {s: {scope: line, type: text, initial: "'a'"}}
tables: {names: {1: one, 2: two}, rows: {1: {x: a}, 2: {x: b}}, lists: {1: [a, b]}}
groups:
  g: {from: client, head: [{field: to, type: u8, values: names}, {field: kind, type: u8}], tail: [{check: sum8}]}
frames:
  A: {group: g, where: {kind: 1}, body: [{require: "p != s"}, {bits: {b: 0-1, c: 2}, of: u8, values: {b: {1: low}}}]}
  D: {group: g, where: {kind: 4}, body: [{inner: it, of: [E, F]}]}
  E: {from: none, body: [{const: 01}, {field: x, type: u8}]}
  F: {from: none, body: [{const: 02}, {field: y, type: u8}]}
  B: {group: g, where: {kind: {build: to}}, body: [{choose: kind, cases: {1: [{const: 01}]}, else: []}]}
  H: {from: client, body: [{const: 05}, {field: z, type: u8, values: names}, {inner: it, of: [E, F]}]}
  K: {from: server, body: [{const: 06}, {field: w, type: u8}]}
  C: {group: g, where: {kind: 3}, body: [{require: "rows[to].x != get(names, to, 'a')"}, {require: "to in lists[1]"}]}
queues: {q: {size: 3, holds: {x: frame}}}
services: {work: [{request: {H: {z: 1, it: {E: {x: 1}}}}, reply: [K: {w: 1}], gives: {y: reply.w}}]}
areas: {word: {unit: word, size: 9}}
addresses: [{form: "M{number:dec}", area: word, start: number}]
roles: {asks: {lanes: {main: {exchange: ask}}}}
sequences:
  ask:
    takes: [request]
    gives: {reply: answer}
    local: {answer: frame, n: u8, t: text, r: record, d: bytes}
    always: [{frame: F, when: it.y == n, then: again}]
    on_noise: again
    steps:
      - {step: a, when: "t != 'b'", session: end, wait: 1 ms, break: 1 ms, set: {n: n + 1, s: "'a'", t: t, d: "h'00'"}}
      - {step: b, call: other, with: {t: t, x: {r: 1}}, into: {n: n}, on_fail: {fail: lost, because: "cause"}}
      - {step: c, ask: {work: {}}, into: {t: y}, put: {q: {x: {E: {x: 1}}}}, deliver: {E: {x: 1}}}
      - step: d
        send: {H: {z: "'one'", it: {E: {x: n}}}}
        urgent: yes
        receive:
          - {frame: H, when: it.z == n, at_most: 3, else: {fail: many}, store: {"h'00'": M1}, set: {answer: it}}
          - {frame: expected, then: resend}
          - {queue: q, when: it.x == 1, then: again}
          - {room: q, then: again}
        within: 1 s
        complete: 1 s
        gap: 1 s
        retries: 2
        on_timeout: [{when: "t == 'a'", send: {E: {x: 1}}, then: again}, {fail: late}]
      - {step: e, parts: {of: d, size: 2}, flush: yes, serve: {request: answer, buffer: part.data, station: 1}}
      - {step: f, branch: [{when: n == 1, take: q, then: end}, {then: end}]}
  other: {takes: [t, x], gives: {n: n}, local: {n: u8}, steps: [{step: g, send: {E: {x: 1}}}]}
"""


# ---- definitions, as mappings and lists of texts ----------------------------------------------------------------


class Bare(str):
    """A scalar without quotes."""


def plain(node: Node) -> Any:
    if isinstance(node, Scalar):
        return node.text if node.quoted or re.fullmatch(r"[\w.+-]+", node.text) is None else Bare(node.text)
    if isinstance(node, Mapping):
        return {entry.key.text: plain(entry.value) for entry in node.entries}
    return [plain(item) for item in node.items]


def yaml_of(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)}: {yaml_of(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(yaml_of, value)) + "]"
    return value if isinstance(value, Bare) else json.dumps(value)


@cache
def documents() -> tuple[Any, ...]:
    """Return definitions that have every kind of node: the cases of segments, and shipped definitions for the rest."""
    texts = sorted([FOLDED, *(case.yaml for cases in SECTIONS.values() for case in cases)], key=len)
    texts.append(SMALL)
    files = [file for file in shipped_definitions() if "." not in file.stem]
    texts += [file.read_text() for file in sorted(files, key=lambda file: file.stat().st_size)]
    return tuple(plain(read_text(text, "text")) for text in texts)


# ---- places of the schema -----------------------------------------------------------------------------------------


def schema_at(place: str) -> tuple[str, Any]:
    """Return the schema at `FILE#/PATH` with all references resolved, and its own location."""
    while True:
        file, _, path = place.partition("#")
        schema = _schemas()[file]
        for step in path.strip("/").split("/") if path else ():
            schema = schema[int(step)] if isinstance(schema, list) else schema[step]
        if "$ref" not in schema:
            return place, schema
        place = schema["$ref"]


def spots(value: Any, place: str, path: tuple[Any, ...] = ()) -> Iterator[tuple[str, str, tuple[Any, ...], str]]:
    """Yield every key that the value has or may have: enclosing schema, name, path, schema location."""
    place, schema = schema_at(place if "#" in place else f"{place}#")
    for key in schema.get("dependentSchemas", ()):
        if isinstance(value, dict) and key in value:
            yield from spots(value, f"{place}/dependentSchemas/{key}", path)
    if isinstance(value, dict):
        known = schema.get("properties", {})
        for key in known:
            yield place, key, (*path, key), f"{place}/properties/{key}"
            if key in value:
                yield from spots(value[key], f"{place}/properties/{key}", (*path, key))
        if isinstance(schema.get("additionalProperties"), dict):
            for key in [key for key in value if key not in known]:
                yield place, "*", (*path, key), f"{place}/additionalProperties"
                yield from spots(value[key], f"{place}/additionalProperties", (*path, key))
    elif isinstance(value, list) and "items" in schema:
        for number, item in enumerate(value):
            yield place, "[]", (*path, number), f"{place}/items"
            yield from spots(item, f"{place}/items", (*path, number))


@cache
def key_cases() -> dict[str, dict[str, tuple[Any, tuple[Any, ...], str]]]:
    """Return by schema and name: the smallest definition that has the key, its path, and its schema location."""
    found: dict[str, dict[str, tuple[Any, tuple[Any, ...], str]]] = {}
    for document in documents():
        for around, name, path, place in spots(document, "protocol.schema.json"):
            if path[0] not in NOT_READ:
                found.setdefault(around, {}).setdefault(name, (document, path, place))
    return found


def changed(value: Any, path: tuple[Any, ...], new: Any) -> Any:
    """Return the value with a replacement at a path."""
    if not path:
        return new
    step, *others = path
    if isinstance(value, list):
        return [changed(item, tuple(others), new) if place == step else item for place, item in enumerate(value)]
    return {**value, step: changed(value.get(step), tuple(others), new)}


def variants(text: str) -> list[Any]:
    """Return a text in the forms in which a definition may contain it."""
    inside = "'" + re.sub(r"([\\'])", r"\\\1", text) + "'"
    lists, mappings = [[text], [Bare("1"), text]], [{"1": text}, {text: Bare("1")}, {"build": inside}]
    return [text, inside, f"1 if {inside} != 'a' else 2", *lists, *mappings]


# ---- generated source ---------------------------------------------------------------------------------------------


class NoFunctions:
    """A codec without functions, for code that only lists frames."""

    def __init__(self, protocol: Protocol) -> None:
        self.frames = dict.fromkeys(protocol.frames, self)
        self.encode = self.decode = self.measure = self.extent = self.diagnose = None
        self.layouts: dict[str, Any] = {}
        self.fused: dict[str, Any] = {}


def sources(protocol: Protocol, size: int, section: str) -> Iterator[str]:
    """Yield the sources that the section can affect; codecs do not read sequences, as another test shows."""
    if section != "sequences":
        yield generate_source(protocol)
    table: Any = FrameTable(protocol, NoFunctions(protocol))  # type: ignore[arg-type]
    yield sequence_source(protocol, table)
    if size > LARGE or section == "sequences":
        return
    yield generate_source(protocol, standalone=False)
    builders = BuilderModules(protocol)
    for name in protocol.frames:
        yield builders.source((name,))[1]


class WithoutTexts(ast.NodeTransformer):
    """Replace texts by empty texts, and also numbers, which may come from the bytes of a text."""

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        return ast.Constant("" if isinstance(node.value, (str, bytes)) or type(node.value) is int else node.value)


def shape(source: str) -> list[str]:
    """Return the syntax of a module's parts without texts.

    The parts are cached, since most of them occur in many modules.
    """
    return [shape_of(part) for part in source.split("\n\n\n")]


@cache
def shape_of(part: str) -> str:
    tree = ast.parse(part)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.FunctionDef, ast.ClassDef)):
            after = zip([None, *node.body], node.body, strict=False)
            documented = (ast.Assign, ast.AnnAssign)  # a string below an attribute is its documentation
            loose = [one for before, one in after if isinstance(one, ast.Expr) and not isinstance(before, documented)]
            assert sum(isinstance(statement.value, ast.Constant) for statement in loose) <= 1
    return ast.dump(WithoutTexts().visit(tree))


def shapes(document: Any, section: str = "") -> list[list[str]] | None:
    """Return the syntax of all modules of a definition, or None if it is refused."""
    try:
        protocol = load_protocol_text(yaml_of(document), "hostile")
        return [shape(source) for source in sources(protocol, len(yaml_of(document)), section)]
    except DefinitionError as error:
        assert str(error).isprintable() or len(str(error).splitlines()) == len(error.problems)
        return None


PARTS = 36


@pytest.mark.parametrize(("part", "form"), spread(product(range(PARTS), range(len(variants("")))), 10, part=3))
def test_text_of_a_key_gives_the_same_source_whatever_it_holds(part: int, form: int) -> None:
    places = [place for around in sorted(key_cases())[part::PARTS] for place in key_cases()[around].values()]
    for document, path, place in places:
        fits = _validator("protocol").evolve(schema=schema_at(place)[1])
        for wrong, right in ((variants(text)[form], variants(harmless)[form]) for text, harmless in TEXTS.items()):
            found = shapes(changed(document, path, wrong), path[0]) if fits.is_valid(wrong) else None
            if found is not None:
                assert found == shapes(changed(document, path, right), path[0]), (path, wrong)
                break


def test_every_key_of_the_schema_is_tried_but_those_of_sections_that_no_generator_reads() -> None:
    known = _schemas()["protocol.schema.json"]
    assert known["properties"].keys() - NOT_READ == key_cases()["protocol.schema.json#"].keys()
    segments = {part["$ref"] for part in known["$defs"]["segment"]["dependentSchemas"].values()}
    names = ("frame", "group", "check_method", "where", "echo", "announces")
    assert segments | {f"protocol.schema.json#/$defs/{name}" for name in names} <= key_cases().keys()


@pytest.mark.parametrize("name", ["third-party-plc", "modbus-rtu"])
def test_generators_read_nothing_of_the_other_sections(name: str) -> None:
    protocol = load_protocol(name)
    others: dict[str, Any] = {field.name: object() for field in fields(protocol) if field.name not in READ}
    for standalone in (True, False):
        assert generate_source(replace(protocol, **others), standalone) == generate_source(protocol, standalone)


@pytest.mark.parametrize(
    "text", [HOSTILE, SHORT, "(abc).x", "a\rb", "'", '"', '""', '"""', "\\", "\ud800", "{", "{{}}"]
)
def test_every_way_to_write_a_text_gives_that_text(text: str) -> None:
    assert ast.literal_eval(quoted(text)) == text
    for code in ("name", "names['a']"):
        source = text_source(text, Code(code), text)
        assert eval(source, {"name": 5, "names": {"a": 5}}) == f"{text}5{text}"
    for lines in ((text,), (text, text), (text, "", text)):
        out = Source(1)
        out.docstring(*lines)
        out.comment(text)
        out.add("x = 1", text)
        tree = ast.parse("def f():\n" + out.text())
        assert isinstance(tree.body[0], ast.FunctionDef) and len(tree.body[0].body) == 2
        others = [*("    " + line if line else "" for line in lines[1:]), "    "] if len(lines) > 1 else []
        assert ast.get_docstring(tree.body[0], clean=False) == "\n".join([lines[0], *others])


def test_a_line_of_source_holds_no_sign_that_is_not_shown() -> None:
    with pytest.raises(ValueError, match="no line of source"):
        Source().add("x = 'a\nboom()'")


def test_no_generator_puts_text_between_quotes_or_into_a_comment_itself() -> None:
    """Between the quotes of a text and in a comment, an f-string of a generator contains no placeholder."""
    for file in Path(generate.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.JoinedStr) and file.stem not in {*PASTED, "source"}:
                text = "".join(str(part.value) if isinstance(part, ast.Constant) else "\0" for part in node.values)
                before = re.split("\0", text)[:-1]
                assert all("".join(before[: n + 1]).count('"') % 2 == 0 for n in range(len(before))), (
                    file,
                    node.lineno,
                )
                assert re.search("#.*\0", text) is None, (file, node.lineno)


@pytest.mark.parametrize("text", [HOSTILE, SHORT, "(abc).x"])
def test_expressions_of_the_link_procedure_are_written_as_they_are(text: str) -> None:
    inside = "'" + re.sub(r"([\\'])", r"\\\1", text) + "'"
    at = Position("x", 1, 1)
    assert compile_expression(parse_expression(f"{inside} if 1 else n", at))(Names()) == text


def test_a_file_is_named_in_the_source_as_a_text(tmp_path: Path) -> None:
    for name in ('a"""; boom(); """.yaml', "a\nboom().yaml", "a\\.yaml", "{boom()}.yaml"):
        (tmp_path / name).write_text(SMALL)
        source = generate_source(load_protocol(tmp_path / name))
        tree = ast.parse(source)
        assert shape(source) == shape(generate_source(load_protocol_text(SMALL)))
        words = name.rpartition("\\")[2].split()
        assert all(word in (ast.get_docstring(tree) or "") for word in words)


# ---- names --------------------------------------------------------------------------------------------------------


def broken_names() -> Iterator[tuple[str, Any]]:
    """Yield definitions in which one name of the small definition ends with a line feed."""
    document = documents()[0]
    for around, name, path, place in spots(document, "protocol.schema.json"):
        if name == "*":
            keys = schema_at(around)[1].get("propertyNames")
            if keys is None or not schema_at(around + "/propertyNames")[1]["pattern"].startswith("^[A-Za-z"):
                continue
            yield ".".join(map(str, path)), changed(document, path[:-1], {f"{path[-1]}\n": "1"})
        elif schema_at(place)[1].get("pattern", "").startswith("^[A-Za-z"):
            value = document
            for step in path:
                value = value.get(step, "") if isinstance(value, dict) else value[step]
            if not isinstance(value, (dict, list)):
                yield ".".join(map(str, path)), changed(document, path, f"{value or 'a'}\n")


@pytest.mark.parametrize(
    ("path", "document"), list(broken_names()), ids=lambda value: value if isinstance(value, str) else ""
)
def test_a_name_ends_where_its_pattern_ends(path: str, document: Any) -> None:
    with pytest.raises(DefinitionError, match=r"\\n'"):
        load_protocol_text(yaml_of(document), "broken")


def test_words_of_python_are_names_like_others() -> None:
    words = [*keyword.kwlist, *keyword.softkwlist, "data", "values", "ctx", "self", "n", "frame", "raw", "start", "end"]
    words += ["print", "len", "bytes", "int", "struct", "Struct", "__class__", "__builtins__", "__name__", "__dict__"]
    body = ", ".join(f"{{field: {word}, type: u8}}" for word in words)
    called = ("class", "import", "a.b", "a-b", "a_b", "encode", "FRAMES", "None")
    frames = "".join(f"  {name}: {{body: [{{const: {place:02X}}}, {body}]}}\n" for place, name in enumerate(called))
    codec = compile_protocol(load_protocol_text(f"protocol: class\nframes:\n{frames}"))
    names: dict[str, Any] = {"__name__": "class"}
    exec(generate_source(codec.protocol), names)
    given = {word: place for place, word in enumerate(words)}
    for name in codec.protocol.frames:
        data = codec.encoders[name](given, {})
        assert data[1:] == bytes(range(len(words)))
        assert names["FRAMES"][name].encode(given) == data
        assert names["FRAMES"][name].decode(data) == given
        build = Builders(codec, {}).builder(name)
        assert build(**{keyword: place for place, keyword in enumerate(signature(build).parameters)}) == data
