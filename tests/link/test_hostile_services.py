"""Text in services, areas and addresses never becomes code in the functions of service rows, as in all other source."""

from __future__ import annotations

from functools import cache
from itertools import product
from pathlib import Path
from types import CodeType
from typing import Any

import pytest
from codec.test_hostile_texts import TEXTS, changed, plain, schema_at, shape, spots, variants, yaml_of
from service.late_world import REGISTERS
from spread import spread

from framekit.codec.codec import code_of, codec_from
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.nodes import read_text
from framekit.definition.problems import DefinitionError
from framekit.definition.schema import _validator
from framekit.link import value_source
from framekit.link.services import client, matching
from framekit.link.services.server import MemoryServer
from framekit.link.value_source import code_of_source
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

SECTIONS = ("services", "areas", "addresses", "errors", "server", "station")
LISTS = """
protocol: lists
extends: standard
groups: {request: {from: client}}
layouts: {pair: [{field: a, type: u8}, {field: b, type: u8}]}
tables: {names: {1: one, 2: two}}
frames:
  ask: {group: request, body: [{const: STX}, {count: n, type: u8, of: items}, {repeat: items, times: n, of: [{field: area, type: u8}, {field: at, type: u16}]}, {check: crc16-modbus}]}
  back: {from: server, body: [{const: ACK}, {count: n, type: u8, of: items}, {repeat: items, times: n, of: [{data: data, size: 2}]}, {check: crc16-modbus}]}
  name: {group: request, body: [{const: SOH}, {field: kind, type: u8, values: names}, {field: text, type: ascii, size: 4, pad: 20}, {data: d, size: 2}, {check: crc16-modbus}]}
  named: {from: server, body: [{const: SOH ACK}, {field: kind, type: u8, values: names}, {data: d, size: 2}, {check: crc16-modbus}]}
  no: {from: server, body: [{const: NAK}, {field: code, type: u8}, {check: crc16-modbus}]}
  many: {group: request, body: [{const: ENQ}, {count: n, type: u8, of: words}, {count: m, type: u8, of: doubles}, {repeat: words, times: n, of: [{field: area, type: u8}]}, {repeat: doubles, times: m, of: [{field: area, type: u8}]}]}
  told: {from: server, body: [{const: EOT}, {count: n, type: u8, of: words}, {count: m, type: u8, of: doubles}, {repeat: words, times: n, of: [{data: data, size: 2}]}, {repeat: doubles, times: m, of: [{data: data, size: 4}]}]}
areas: {D: {unit: word, size: 100, code: {word: 7}, column: "'a'"}, C: {unit: word, size: 100, code: {word: 8, bit: 9}, column: "'b'"}}
addresses: [{form: "{area}{start:dec}"}]
errors: {frame: no, code: code, names: names, answer: {no: {code: code}}, memory: {unknown: 1, range: 2, access: 3}}
services:
  read:
    - {areas: [D, C], units: [word], variables: {max: 8, same: unit}, limit: {count: 1}, request: {ask: {items: {each: {area: code, at: start}}}}, reply: {back: {items: {each: {data: data}}}}}
    - areas: [C]
      variables: {max: 8}
      limit: {bytes: 4}
      request: {many: {words: {each: {area: start}, when: "bytes == 2 and unit == 'word'"}, doubles: {each: {area: start}, when: bytes == 4}}}
      reply: {told: {words: {each: {data: data}, when: bytes == 2}, doubles: {each: {data: data}, when: bytes == 4}}}
  hello:
    - {takes: {who: {type: text, default: "'me'"}}, when: "who != 'you'", request: {name: {kind: "'one'", text: who, d: {pair: {a: 1, b: 2}}}}, reply: {named: {kind: "'two'", d: "h'01 02'"}}, gives: {kind: reply.kind, text: "'a' + text(reply.kind)"}}
"""  # noqa: E501


@cache
def documents() -> tuple[Any, ...]:
    rack = (Path(__file__).parents[1] / "data" / "rack.yaml").read_text()
    return tuple(plain(read_text(text, "text")) for text in (REGISTERS, LISTS, rack))


EACH = 2
"""Number of places tested per key of the schema: the first, and another after the middle."""


def places() -> list[tuple[int, tuple[Any, ...], str]]:
    """Return the tested places: document number, path and schema location."""
    found: dict[str, list[tuple[int, tuple[Any, ...], str]]] = {}
    for number, document in enumerate(documents()):
        for path, place in {path: place for _, _, path, place in spots(document, "protocol.schema.json")}.items():
            if path[0] in SECTIONS:
                found.setdefault(place, []).append((number, path, place))
    return [place for same in found.values() for place in same[:: max(-(-len(same) // EACH), 1)]]


PLACES = places()


@cache
def module_code(number: int) -> CodeType:
    """Return the compiled frames of a document, which the changes of this module do not affect: see NOT_READ."""
    return code_of(load_protocol_text(yaml_of(documents()[number]), "hostile"))


def sources(number: int, document: Any, monkeypatch: pytest.MonkeyPatch) -> list[str] | None:
    """Return the source of every function of every row, of client and server; None if the definition is refused."""
    found: list[str] = []

    def noted(source: str) -> CodeType:
        found.append(source)
        return code_of_source("def function(*_):\n    pass\n")

    monkeypatch.setattr(value_source, "code_of_source", noted)
    try:
        protocol = load_protocol_text(yaml_of(document), "hostile")
    except DefinitionError:
        return None
    codec = codec_from(protocol, module_code(number))
    server = MemoryServer(protocol, codec, DeviceMemory(memory_of(protocol)[0]))
    errors = client.ErrorReader(server.shared)
    for rows in server.shared.rows.values():
        for row in (client.ClientRow(facts, errors) for facts in rows):
            assert row._make and row.give
            for name in {None, *row.reply.expected}:
                row.reply._fitting(None if name is None else FrameValue(name, {}))
    for row in (row for rows in server._rows.values() for row in rows):
        row.matching.serving()
        for with_buffer in (False, True):
            matching.RowWriter(row.matching, with_buffer, False).function()
    return found


def test_these_definitions_have_functions_for_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    for number, document in enumerate(documents()):
        found = sources(number, document, monkeypatch)
        assert found is not None and len(found) > 8
    assert {path[0] for _, path, _ in PLACES} == set(SECTIONS)


PARTS = 12


@pytest.mark.parametrize(("form", "part"), spread(product(range(len(variants(""))), range(PARTS)), 2 * PARTS, PARTS))
def test_text_gives_the_same_functions_whatever_it_holds(form: int, part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, path, place in PLACES[(part + form) % PARTS :: PARTS]:
        fits = _validator("protocol").evolve(schema=schema_at(place)[1])
        for wrong, right in ((variants(text)[form], variants(harmless)[form]) for text, harmless in TEXTS.items()):
            if not fits.is_valid(wrong):
                continue
            found = sources(number, changed(documents()[number], path, wrong), monkeypatch)
            if found is not None:
                harmless_ones = sources(number, changed(documents()[number], path, right), monkeypatch)
                assert harmless_ones is not None
                assert list(map(shape, found)) == list(map(shape, harmless_ones)), (path, wrong)
                break
