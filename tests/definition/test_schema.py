"""The schemas: accepted definitions, and the messages and places of refusals."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from framekit.definition.nodes import Mapping, Node, Scalar, Sequence, read_nodes, read_text
from framekit.definition.problems import DefinitionError
from framekit.definition.schema import FIRST_KEYS, Kind, kind_of, validate, wrong_kind
from framekit.definition.sources import shipped_definitions, shipped_folder

SHIPPED = shipped_definitions()
SCHEMAS = sorted(shipped_folder("schemas").glob("*.schema.json"))


def problems_of(text: str) -> list[str]:
    node = read_text(text, "f")
    return [str(problem) for problem in validate(node, kind_of(node))]


def subschemas(schema: Any) -> Iterator[dict[str, Any]]:
    if isinstance(schema, dict):
        yield schema
        schema = list(schema.values())
    if isinstance(schema, list):
        for part in schema:
            yield from subschemas(part)


# ---- the schemas themselves ---------------------------------------------------------------------------------


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_schemas_are_valid(path: Path) -> None:
    schema = json.loads(path.read_text(encoding="utf-8"))
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    Draft202012Validator.check_schema(schema)


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_references_lead_somewhere(path: Path) -> None:
    schema = json.loads(path.read_text(encoding="utf-8"))
    for part in subschemas(schema):
        if isinstance(reference := part.get("$ref"), str):
            file, _, pointer = reference.partition("#/$defs/")
            target = json.loads((path.parent / file).read_text(encoding="utf-8")) if file else schema
            assert pointer in target["$defs"], reference


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_closed_mappings_have_a_name_and_patterns_say_what_is_expected(path: Path) -> None:
    schema = json.loads(path.read_text(encoding="utf-8"))
    for part in subschemas(schema):
        if part.get("additionalProperties") is False:
            assert isinstance(part.get("title"), str), list(part["properties"])
        if isinstance(part.get("pattern"), str):
            assert "x-expected" in part, part
        if isinstance(part.get("enum"), list):
            assert "x-name" in part, part


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.name)
def test_every_key_is_described(path: Path) -> None:
    root = json.loads(path.read_text(encoding="utf-8"))
    for part in subschemas(root):
        for name, key in part.get("properties", {}).items() if isinstance(part.get("properties"), dict) else ():
            file, _, pointer = key.get("$ref", "").partition("#/$defs/")
            target = json.loads((path.parent / file).read_text(encoding="utf-8")) if file else root
            described = key.get("description") or target["$defs"].get(pointer, {}).get("description")
            assert described, f"{path.name}: {name}"


# ---- what is right ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_shipped_files_are_right(path: Path) -> None:
    node = read_nodes(path)
    assert validate(node, kind_of(node)) == []


PROTOCOL = """
protocol: everything
about: Every key of the language once.
source: nowhere
profile: snet-user-frames
order: little
uses: [other]
station: {type: text, size: 8, default: '', doc: "empty is taken by any"}
line:
  speed: {default: 9600, choices: [300, 9600]}
  format: {default: 8O1, choices: [8N1, 7E2]}
  turnaround: t1
  key_delay: turnaround
params:
  t1: {type: time, default: "max(3 chars, 5 ms)", range: 0 ms..60 s, doc: first}
  kind: {type: choice, of: [90-30, 90-70], default: 90-30}
  id: {type: bytes, size: 4, default: 10 3A 00 00}
  nodes: {type: list, of: number, default: []}
  on: {type: flag, default: yes}
  formula: {type: time, is: "never if t1 == 0 ms else t1"}
state:
  sent: {scope: line, type: u32, publish: yes, initial: 0}
  words: {scope: device, table: 0..4, holds: text}
  faults: {scope: device, list: point, max: 16}
  facts: {scope: device, record: point}
  mode: {scope: device, type: u8, initial: 2, values: names}
queues:
  outbox: {holds: {station: number, packet: frame}, size: 8}
tables:
  names: {0: run, 1: stop}
  levels: {0x03: {low: 1, high: 0}, 0x04: {low: 1}}
  back_off: {300: [300, 440], 1200-19200: [80, 120]}
  empty: {}
checks:
  bcc: {method: sum8, complement: twos}
  own: {fold: "rotl8(acc ^ byte, 1)", initial: 0}
  crc: {width: 16, poly: 0x8005, init: 0xFFFF, refin: yes, refout: yes, xorout: 0}
layouts:
  point: [{field: selector, type: u8}, {field: offset, type: u16, order: CDAB}]
  all:
    - {const: DLE STX 0D0A, name: start}
    - text: RSS
    - {field: a, type: hex, size: 2, range: 1..16, refuse: 0x04, values: names, only: values, plus: 0x20, case: lower}
    - {field: b, type: u8, unit: ms, long: {mark: 0xFF, type: u16}, zero_means: 256, is: 1, when: a > 1}
    - {field: c, type: ascii, end: 00, pad: 20, build: "'x'", default: '', memory: M10}
    - {bits: {low: 0-3, high: 7}, of: hex, size: 2, is: {low: 1}, build: {high: a > 2},
       values: {low: names}, name: flags}
    - {data: d, size: rest, convert: hex_to_ascii, swap: 2, pad: 00, min: 1, memory: M100}
    - {length: n, type: u16, of: [d], plain: yes, unit: words, plus: 1, range: 0..9, zero_means: 256}
    - {count: m, type: u8, of: list}
    - {repeat: list, times: m, of: [{include: point}]}
    - {repeat: numbers, times: rest, of: u16}
    - {choose: a, cases: {3: [{skip: 1}], "16, 17": []}, else: [{skip: 2, fill: 30 20}]}
    - optional: [{include: point, as: more}]
    - {inner: pdu, of: [other.request, reply], size: n - 1}
    - {wrap: hex, of: [{check: lrc8, over: "a..here"}]}
    - {wrap: {escape: DLE}, of: [], inside: [ack], insert: embedded, min: 6, max: limit}
    - {check: crc16-modbus, over: [a, b], as: HEX, order: little, verify: warn, size: 4}
    - {value: v, read: a + 1, build: 2}
    - {require: "a in [1, 2]", refuse: 3, doc: why}
groups:
  request: {from: client, head: [{const: ENQ}], tail: [{const: EOT}], delimited: yes, surplus: 0x1234, max: 256}
  reply: {from: server, extends: request, echo: {a: b}, announces: {left: a}, size: 32, fill: 00}
frames:
  WR.REQ: {group: request, where: {command: [r, R], type: SS, x: {build: "digits(1, 2)"}}, body: [{include: all}]}
  RD: {group: reply, echo: [a, b], body: [], refuse: 0x10, from: both}
receiver: {gap: t1, quiet: 3 chars, symbols: DLE, resync: after_quiet}
sequences:
  exchange:
    takes: [request]
    gives: {reply: answer}
    local: {answer: frame, tries: u8}
    always: [{frame: ack, when: on, then: ready}]
    on_break: {then: end}
    steps:
      - {step: one, when: on, session: new, parts: {of: buffer, size: 8}, call: other, with: {a: {x: 1}}, into: {b: c}}
      - {step: two, wait: 4 chars, on_byte: {then: one}, break: t1, set: {"t[1]": 2, frame.x: 3}}
      - {step: three, serve: {request: asked, buffer: b, station: s, check: yes},
         put: {outbox: {station: 1}}, send: reply}
      - {step: four, ask: {status: {}}, on_fail: [again, {then: end}]}
      - step: five
        send: {WR.REQ: {station: own}}
        receive:
          - {frame: [RD, expected], when: "it.a in [1, 2]",
             at_most: retries, else: {fail: lost}, set: {x: it}, then: end}
          - {queue: outbox, take: outbox, store: {it.d: M100}, deliver: it, send: ack, then: again}
          - {room: outbox, fail: full}
        within: t1
        complete: 10 chars
        gap: t1
        retries: 3
        on_timeout: resend
        on_bad: [{when: on, then: resend}, {then: end}]
        on_exhausted: {fail: lost}
      - {step: six, branch: [{when: on, then: one}, end]}
roles:
  master: {session: link, lanes: {main: {exchange: [exchange], listen: exchange, at_once: 2}}}
sessions:
  link: {open: [exchange], close: exchange, one_station: not on, keep_alive: {after: t1, run: exchange}, lost_by: any}
areas:
  M: {unit: word, size: 2048, access: rw, code: 1, memory: R, digits: 4}
  C: {size: 6, code: {bit: 0x46, byte: 0x10}, layout: point, unit: 6 bytes}
addresses:
  - {form: "{area}[{file:dec}]:{start:dec}", unit: bit, area: M, start: file * 2, file: "either(file, 3)", wire: yes}
errors: {frame: RD, when: a != 0, code: a, names: [names], answer: {RD: {a: code}}, memory: {unknown: 1, no_service: 2}}
server: {refuse: [{when: "request.a > 1", code: 1}]}
commands: {frame: WR.REQ, request: inner, most: 10, status: {code: 1, start: 0}, done: 1, failed: code,
           meaning: "''", waits: 1 s, then: [{when: on, store: {text: x, data: d}}]}
services:
  read:
    - name: plain
      areas: [M]
      units: [word, 6 bytes]
      when: on
      limit: {count: 4, bytes: max_bytes}
      align: {bits: 8}
      variables: {max: 16, same: unit}
      request: {WR.REQ: {a: start, list: {each: {name: text}}}}
      buffer: {point: {offset: 1}}
      reply: [{RD: {d: data}, when: bytes <= 6}, {RD: {}, buffer: data}]
      packing: {order: little, bits: byte_each}
      gives: {x: {point: buffer}}
      run: "'normal'"
      back: {area: M, start: request.a, count: 1, bits: "[1]"}
      refuse: [{when: on, code: 3}]
      serve: {let: {a: 1}, span: {memory: R, start: 1, count: 1}, update: old + 1, set: {x: 1},
              drop: {from: t, when: on}}
  other:
    - takes: {register: {type: number, range: 0..31, default: 1}}
      serve: {read: "monitors[1]", each: list, as: one, write: {area: M, start: 1, count: 2, data: d},
              block: {station: 1, params: {a: 1}, session: new, read: {code: 1, start: 0},
                      into: {memory: M, start: 0, count: 1},
                      write: {text: x, unit: bit, data: d}, from: {area: R}, call: [{other: {register: 1}}],
                      then: [{when: on, set: {x: 1}, store: {area: M, start: 0, data: d}}]}}
      client_only: yes
      outside_session: yes
"""

RUN = """
run: everything
memory: {profile: masterlogic, areas: {X: {size: 3, aliases: [Y]}}, set: {M0: [1, 2], M1: 3}}
set: {M5: 0x10}
channels:
  1: {port: "sim:x.device.yaml", protocol: p, role: client, speed: 9600, format: 8N1, station: 2, params: {retries: 3}}
  2: {port: /dev/ttyS0, protocol: p, own: 1, retries: 2, timeout: 1 s, silence: 4 chars,
      dead: {failures: 3, every: 10 s}}
blocks:
  0: {send: WR.REQ, channel: 1, when: F00093, data: {payload: M0}, size: {payload: 44}}
  1: {receive: RD.DATA, channel: 1, data: {payload: M100}}
  2: {send: IMM, channel: 1, when: [block 1 done, "M10 > 5"], unless: M00001}
  3: {read: ["%MW1", "%MW2"], into: [M1, M2], every: 200 ms, phase: 0 ms, type: word, count: 1, priority: 2}
  4: {write: 40010, from: M1, on_change: M1, words: 2, repeat: 5, timeout: 2 s, enabled: no}
  5: {call: status, with: {level: 3}, once: yes, name: look}
  6: {read: [M1, M2], into: [M3, M4], while: M00002, after: 3 s}
sets: {2: {blocks: {0: {send: A}}}}
merge: {max: 100, gap: 4}
silence: {between: 5 ms, station: 20 ms}
state: yes
"""

DEVICE = """
device: d
protocol: p
station: 3
memory: {areas: {M: {unit: word, size: 2048}}, set: {M0: [1, 2]}}
params: {retries: 3, own: {type: time, default: 1 s}}
state: {good: {type: u32}}
sequences: {s: {steps: [{step: idle, receive: [{frame: A, store: {it.payload: M100}}]}]}}
roles: {device: {lanes: {main: {listen: s}}}}
"""

VECTORS = """
vectors: p
frames:
  - {frame: a, values: {id: 33101A, list: [{name: x}]}, bytes: 1B 00*32 xx xx*6 DLE check, source: "page 3"}
  - {bytes: 05 30, expect: {bad: check}}
  - {bytes: 05 30, expect: {refused: 0x1234}, from: client, params: {a: 1}, state: {b: {c: 1}}}
conversations:
  - name: all
    role: server
    own: 33101A
    memory: {M100: 0x1234}
    do: {read: "%MW100", station: 1, count: 1}
    script: [{break: 3 chars}, {wait: 50 ms}, {receive: 1B}, {send: 00, not_before: 5 ms, within: 1 s},
             {silence: 1 s}, {line: parity}]
    result: {values: [0x1234], state: {x: 1}, memory: {M1: 2}}
"""

MEMORY = """
memory: m
areas: {M: {unit: word, size: 2048, access: rw, aliases: [N], digits: 4, wire: W, about: relays}}
tables: {units: {X: bit}}
addresses: [{form: "{area}{start:dec}"}]
scan: 10 ms
clocks: {M00001: 20 ms}
fixed: {M00002: on, M00003: first_scan}
flags: {alarm: M00004, status: {area: M, first: 1, words: 6, sets: 8, blocks: 64, items: {done: {word: 0, bit: 0}}}}
"""


@pytest.mark.parametrize(
    "text", [PROTOCOL, RUN, DEVICE, VECTORS, MEMORY], ids=["protocol", "run", "device", "vectors", "memory"]
)
def test_every_key_is_allowed(text: str) -> None:
    assert problems_of(text) == []


def test_an_application_is_a_protocol_file() -> None:
    assert problems_of("application: a\nareas: other\naddresses: other\n") == []


# ---- what kind of file --------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", FIRST_KEYS)
def test_the_first_key_says_what_the_file_is(key: str) -> None:
    assert (
        kind_of(read_text(f"{key}: x\nprotocol: y\n" if key != "protocol" else "protocol: y\n", "f")) == FIRST_KEYS[key]
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("protcol: x\n", "f:1:1: the first key 'protcol' does not say what the file is – did you mean 'protocol'?"),
        (
            "frames: {}\nprotocol: x\n",
            "f:1:1: the first key 'frames' does not say what the file is – begin with "
            "protocol:, application:, device:, run:, vectors:, memory:, faults:, jobs:, points:",
        ),
        (
            "- protocol: x\n",
            "f:1:1: the file does not begin with a key – begin with "
            "protocol:, application:, device:, run:, vectors:, memory:, faults:, jobs:, points:",
        ),
    ],
)
def test_other_first_keys_are_refused(text: str, problem: str) -> None:
    with pytest.raises(DefinitionError) as caught:
        kind_of(read_text(text, "f"))
    assert [str(found) for found in caught.value.problems] == [problem]


@pytest.mark.parametrize(
    ("text", "wanted", "problem"),
    [
        ("protocol: p\nframes: {}\n", "run", "this is a protocol, not a run file – name a file that begins with run:"),
        (
            "protocol: p\nframes: {}\n",
            "device",
            "this is a protocol, not a device file – name a file that begins with device:",
        ),
        (
            "device: d\nprotocol: p\n",
            "protocol",
            "this is a device file, not a protocol – name a file that begins with protocol: or application:",
        ),
        (
            "run: r\nmemory: m\n",
            "memory",
            "this is a run file, not a memory profile – name a file that begins with memory:",
        ),
        ("vectors: v\nframes: []\n", "protocol", "this is a vectors file, not a protocol – "),
    ],
)
def test_a_file_of_another_kind_is_told_as_such(text: str, wanted: Kind, problem: str) -> None:
    wrong = wrong_kind(read_text(text, "f"), wanted)
    assert wrong is not None and str(wrong).startswith(f"f:1:1: {problem}")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("memory: m\nrun: r\n", "run"),
        ("protocol: p\ndevice: d\n", "device"),
        ("application: a\n", "protocol"),
        ("frames: {}\n", "protocol"),
        ("prtocol: p\n", "protocol"),
        ("- run\n", "run"),
    ],
)
def test_what_may_be_such_a_file_is_read(text: str, wanted: Kind) -> None:
    assert wrong_kind(read_text(text, "f"), wanted) is None


# ---- what is wrong ------------------------------------------------------------------------------------------

SEGMENTS = [
    ("{field: x, type: u8, siez: 2}", "22: unknown key 'siez' in a field segment of frame 'A' – did you mean 'size'?"),
    ("{data: x}", "1: missing key 'size' in a data segment of frame 'A' – add it"),
    ("{data: x, siz: 4}", "11: unknown key 'siz' in a data segment of frame 'A' – did you mean 'size'?"),
    ("{length: x}", "1: missing keys 'type', 'of' in a length segment of frame 'A' – add them"),
    ("{feld: x, type: u8, values: t}", "2: unknown key 'feld' in a segment of frame 'A' – did you mean 'field'?"),
    (
        "{type: u8}",
        "1: a segment of frame 'A' has no kind – add one of field, include, const, data, text, length, count, bits, …",
    ),
    (
        "{const: 00, field: x, type: u8}",
        "13: a segment of frame 'A' has more than one kind: 'const' and 'field' – keep one",
    ),
    ("const", "1: an item of 'body' of frame 'A' must be a mapping, not a text – write key: value"),
    ("{const: 0}", "9: '0' is not bytes (hex pairs and control names, 1B 54 or DLE STX), in frame 'A'"),
    (
        "{const: }",
        "9: 'const' of frame 'A' is empty – write bytes (hex pairs and control names, 1B 54 or DLE STX)",
    ),
    ("{skip: many}", "8: 'many' is not a whole number (10 or 0x0A), in frame 'A'"),
    ("{field: 1x, type: u8}", "9: '1x' is not a name (letters, digits and _), in frame 'A'"),
    ("{field: x, type: u9}", "18: 'u9' is not a type, in frame 'A' – did you mean 'u8'?"),
    (
        "{field: x, type: u16, order: sideways}",
        "30: 'sideways' is not an order, in frame 'A' – known: big, little, ABCD, CDAB, BADC, DCBA",
    ),
    (
        "{field: x, name: y, type: u8}",
        "12: unknown key 'name' in a field segment of frame 'A' – the field's name is what stands behind 'field:'",
    ),
    ("{field: d, type: u8, range: 1-16}", "29: '1-16' is not a range (1..16), in frame 'A' – write 1..16"),
    ("{bits: {a: 1, b: x}, of: u8}", "18: 'x' is not a bit or bits (3 or 4-7), in frame 'A'"),
    ("{repeat: x, times: 2, of: [{skip: x}]}", "35: 'x' is not a whole number (10 or 0x0A), in frame 'A'"),
    ("{repeat: x, times: 2, of: u7}", "27: 'u7' is not a type, in frame 'A' – did you mean 'u8'?"),
    (
        "{wrap: base64, of: []}",
        "8: 'base64' is not a wrap (hex, cobs, none, {escape: …}, {after: …}, {block: …}, {short: …} or "
        "{cipher: …}), in frame 'A'",
    ),
    ("{wrap: {escpe: DLE}, of: []}", "9: unknown key 'escpe' in a wrap of frame 'A' – did you mean 'escape'?"),
    (
        "{check: sum8, over: {a: b}}",
        "21: 'over' of frame 'A' must be a list or a single value, not a mapping – write a range of segments "
        "(first..last or [names]; an offset in bytes may stand for a name)",
    ),
    ("{data: d, size: max(a, b)}", "24: the expression was cut at a comma – quote the whole expression"),
    ("{data: d, size: min(a, b, c), min: 1}", "24: the expression was cut at a comma – quote the whole expression"),
    ("{field: d, type: u8, doc: first, then more}", "34: the text was cut at a comma – quote the whole text"),
    (
        "{field: d, type, size: 1}",
        "12: the expression was cut at a comma – quote the whole expression, or give 'type' a value",
    ),
    ("{require: [a]}", "11: 'require' of frame 'A' must be a single value, not a list – quote the whole expression"),
]


@pytest.mark.parametrize(("segment", "problem"), SEGMENTS)
def test_wrong_segments(segment: str, problem: str) -> None:
    column, _, rest = problem.partition(": ")
    found = problems_of(f"protocol: p\nframes:\n  A:\n    body:\n      - {segment}\n")
    assert found == [f"f:5:{int(column) + 8}: {rest}"]


SECTIONS = [
    ("frames: hello", "9: 'frames' must be a mapping, not a text – write key: value"),
    ("frames:", "8: 'frames' must be a mapping, not empty – write key: value"),
    ("frames: [a]", "9: 'frames' must be a mapping, not a list – write key: value"),
    ("frames: {A: {head: []}}", "14: unknown key 'head' in frame 'A' – a head belongs to a group"),
    (
        "frames: {A: {body: {const: 00}}}",
        "20: 'body' of frame 'A' must be a list, not a mapping – write [a, b], or lines that begin with '- '",
    ),
    ("frames: {A B: {}}", "10: 'A B' is not a name (letters, digits, _ . -), in 'frames'"),
    (
        "frames: {A: {where: {x: {bild: 1}}}}",
        "26: unknown key 'bild' in a where entry of frame 'A' – did you mean 'build'?",
    ),
    ("frmaes: {}", "1: unknown key 'frmaes' in a protocol file – did you mean 'frames'?"),
    ("order: sideways", "8: 'sideways' is not a byte order – known: big, little"),
    ("line: {sped: 9600}", "8: unknown key 'sped' in the line section – did you mean 'speed'?"),
    ("line: {speed: fast}", "15: 'fast' is not a line speed (9600)"),
    ("groups: {g: {form: client}}", "14: unknown key 'form' in group 'g' – did you mean 'from'?"),
    ("groups: {g: {delimited: maybe}}", "25: 'maybe' is not a flag, in group 'g' – write yes or no"),
    (
        "params: {t: {type: tme}}",
        "20: 'tme' is not a type of parameter, in parameter 't' – did you mean 'time' or 'text'?",
    ),
    ("state: {x: {scope: all}}", "20: 'all' is not a scope, in state variable 'x' – known: line, session, device"),
    ("tables: {t: 5}", "13: table 't' must be a mapping, not a text – write key: value"),
    ("tables: {t: {1: a, b}}", "20: the text was cut at a comma – quote the whole text"),
    ("checks: {c: {methd: sum8}}", "14: unknown key 'methd' in check method 'c' – did you mean 'method'?"),
    (
        "areas: {M: {unit: nibble}}",
        "19: 'nibble' is not a unit (bit, byte, word, dword, lword or 6 bytes), in area 'M'",
    ),
    ("areas: {M: {siz: 3}}", "13: unknown key 'siz' in area 'M' – did you mean 'size'? If not, give it another name"),
    ("addresses: [{start: x}]", "13: missing key 'form' in address form 1 – add it"),
    ("errors: {memory: {rnge: 3}}", "19: unknown key 'rnge' in the memory codes – did you mean 'range'?"),
    ("server: {refuse: [{when: x}]}", "19: missing key 'code' in a refusal – add it"),
    (
        "services: {read: {areas: [M]}}",
        "18: service 'read' must be a list, not a mapping – write [a, b], or lines that begin with '- '",
    ),
    (
        "services: {read: [{name: a, limit: {byts: 3}}]}",
        "37: unknown key 'byts' in the limit of row 'a' of service 'read' – did you mean 'bytes'?",
    ),
    (
        "services: {read: [{request: {a: {}, b: {}}}]}",
        "37: 'request' of row 1 of service 'read' has more than one entry: a, b – "
        "write the name of one frame with its values, {NAME: {field: value}}",
    ),
    (
        "roles: {a: {lanes: {main: {exchang: x}}}}",
        "28: unknown key 'exchang' in lane 'main' of role 'a' – did you mean 'exchange'?",
    ),
    ("sequences: {s: {takes: [a]}}", "16: missing key 'steps' in sequence 's' – add it"),
    ("sequences: {s: {steps: []}}", "24: 'steps' of sequence 's' is empty – write at least one entry"),
    ("sequences: {s: {steps: [{send: x}]}}", "25: missing key 'step' in step 1 of sequence 's' – add it"),
]


@pytest.mark.parametrize(("section", "problem"), SECTIONS)
def test_wrong_sections(section: str, problem: str) -> None:
    assert problems_of(f"protocol: p\n{section}\n") == [f"f:2:{problem}"]


STEPS = [
    ("{step: ask, snd: x}", "13: unknown key 'snd' in step 'ask' of sequence 's' – did you mean 'send'?"),
    (
        "{step: a, receive: [], branch: [{then: end}]}",
        "24: a step has either 'receive' or 'branch', in step 'a' of sequence 's' – make two steps of it",
    ),
    (
        "{step: a, with: {b: c}}",
        "11: 'with' needs 'call' beside it, in step 'a' of sequence 's' – add call or remove with",
    ),
    ("{step: a, when: }", "17: 'when' of step 'a' of sequence 's' is empty – write an expression"),
    ("{step: a, set: {x: max(a, b)}}", "27: the expression was cut at a comma – quote the whole expression"),
    ("{step: a, set: {x: f(a, b: 1), y: 2}}", "25: the expression was cut at a comma – quote the whole expression"),
    (
        "{step: a, receive: [{frme: x}]}",
        "22: unknown key 'frme' in a row of step 'a' of sequence 's' – did you mean 'frame'?",
    ),
    (
        "{step: a, receive: [{then: end}]}",
        "21: a row of step 'a' of sequence 's' has no condition – add one of frame, queue, room",
    ),
    (
        "{step: a, receive: [{frame: x, queue: y}]}",
        "32: a row of step 'a' of sequence 's' has more than one condition: 'frame' and 'queue' – keep one",
    ),
    (
        "{step: a, receive: [{frame: x, then: end, fail: y}]}",
        "43: a row has either 'then' or 'fail', in step 'a' of sequence 's' – remove one of them",
    ),
    (
        "{step: a, on_bad: [again, {thn: end}]}",
        "28: unknown key 'thn' in an action of step 'a' of sequence 's' – did you mean 'then' or 'when'?",
    ),
    (
        "{step: a, on_bad: is it}",
        "19: 'is it' is not a word that says where to go (next, end, again, restart, resend or a step), "
        "in step 'a' of sequence 's'",
    ),
    (
        "{step: a, parts: {off: x, size: 1}}",
        "19: unknown key 'off' in the parts of step 'a' of sequence 's' – did you mean 'of'?",
    ),
]


@pytest.mark.parametrize(("step", "problem"), STEPS)
def test_wrong_steps(step: str, problem: str) -> None:
    column, _, rest = problem.partition(": ")
    found = problems_of(f"protocol: p\nsequences:\n  s:\n    steps:\n      - {step}\n")
    assert found == [f"f:5:{int(column) + 8}: {rest}"]


OTHERS = [
    ("run: r\nchannels: {1: {port: x}}\n", "f:2:15: missing key 'protocol' in channel 1 – add it"),
    ("run: r\nchannels: {}\n", "f:2:11: 'channels' is empty – write at least one entry"),
    (
        "run: r\nchannels: {1: {port: x, protocol: p}}\nblocks: {0: {read: x, on change of: M1}}\n",
        "f:3:23: unknown key 'on change of' in block 0 – write on_change: ADDRESS",
    ),
    (
        "run: r\nchannels: {1: {port: x, protocol: p}}\nblocks: {2: {channel: 1}}\n",
        "f:3:13: block 2 has no instruction – add one of read, write, send, receive, call, command, report, abort, …",
    ),
    (
        "run: r\nchannels: {1: {port: x, protocol: p}}\nblocks: {2: {send: a, every: soon}}\n",
        "f:3:30: 'soon' is not a time (50 ms, 3 s or never), in block 2",
    ),
    (
        "run: r\nchannels: {one: {port: x, protocol: p}}\n",
        "f:2:12: 'one' is not the number of a channel (1 or 2), in 'channels' – "
        "number the channels; a name is written as name: in the channel",
    ),
    (
        "run: r\nchannels: {1: {port: x, protocol: p}}\nsets: {9: {blocks: {}}}\n",
        "f:3:8: '9' is not the number of a set (1 to 8), in 'sets'",
    ),
    (
        "run: r\nchannels: {1: {port: x, protocol: p}}\nsets: {2: {blocks: {1: {rad: x}}}}\n",
        "f:3:25: unknown key 'rad' in block 1 of set 2 – did you mean 'read'?",
    ),
    ("device: d\n", "f:1:1: missing key 'protocol' in a device file – add it"),
    (
        "device: d\nprotocol: p\nmemory: {aras: {}}\n",
        "f:3:10: unknown key 'aras' in the memory section – did you mean 'areas'?",
    ),
    ("device: d\nprotocol: p\nmemory: {areas: {M: {unit: word}}}\n", "f:3:21: missing key 'size' in area 'M' – add it"),
    (
        "vectors: p\nframes: [{bytes: 1B ZZ z}]\n",
        "f:2:18: '1B ZZ z' is not bytes of a case (1B 41, xx not compared, 00*32 repeated, check), in frame case 1",
    ),
    (
        "vectors: p\nframes: [{bytes: 00, expect: {bad: chek}}]\n",
        "f:2:36: 'chek' is not a cause, in frame case 1 – did you mean 'check'?",
    ),
    (
        "vectors: p\nconversations: [{name: c, script: [{snd: 00}]}]\n",
        "f:2:37: unknown key 'snd' in a script line of conversation 'c' – did you mean 'send'?",
    ),
    (
        "vectors: p\nconversations: [{name: c, do: {read: {address: M0, count: 2}}, script: []}]\n",
        "f:2:38: 'read' of conversation 'c' must be a list or a single value, not a mapping – "
        "write an address or a list of them, with count: N beside it",
    ),
    (
        "vectors: p\nconversations: [{name: c, do: {send: A}, script: []}]\n",
        "f:2:38: 'send' of conversation 'c' must be a mapping, not a text – write key: value",
    ),
    (
        "vectors: p\nconversations: [{name: c, do: {exchange: {A: {}, B: {}}}, script: []}]\n",
        "f:2:50: 'exchange' of conversation 'c' has more than one entry: A, B – keep one",
    ),
    ("memory: m\nareas: {M: {size: big}}\n", "f:2:19: 'big' is not a whole number (10 or 0x0A), in area 'M'"),
    (
        "memory: m\nareas: {}\nfixed: {F2: maybe}\n",
        "f:3:13: 'maybe' is not a kind of fixed bit – known: on, off, first_scan, after_first_scan, every_scan",
    ),
]


@pytest.mark.parametrize(("text", "problem"), OTHERS)
def test_wrong_files_of_other_kinds(text: str, problem: str) -> None:
    assert problems_of(text) == [problem]


def test_all_problems_come_at_once_in_the_order_of_the_file() -> None:
    text = "protocol: p\norder: x\nframes:\n  A: {body: [{skip: a}, {skip: b}, {sip: 1}]}\nline: {sped: 1}\n"
    assert [problem.split(": ")[0] for problem in problems_of(text)] == ["f:2:8", "f:4:21", "f:4:32", "f:4:37", "f:5:8"]


def test_one_cut_gives_one_problem() -> None:
    text = "protocol: p\nstate: {x: {type: u8, initial: max(1, 2, min(3, 4)), scope: line}}\n"
    assert problems_of(text) == ["f:2:39: the expression was cut at a comma – quote the whole expression"]


@pytest.mark.parametrize("text", ["'('", "a == '('", '"f(a, b)"', "f(a)"])
def test_what_is_whole_is_not_cut(text: str) -> None:
    assert problems_of(f"protocol: p\nsequences: {{s: {{steps: [{{step: a, when: {text}, then: end}}]}}}}\n") == []


# ---- anything -----------------------------------------------------------------------------------------------

RAW_WORDS = (
    "is not of type",
    "Additional properties",
    "is a required property",
    "does not match",
    "is not valid under",
)


def words_in(node: Node) -> list[str]:
    """Return the texts of all scalars, keys included."""
    if isinstance(node, Scalar):
        return [node.text]
    if isinstance(node, Sequence):
        return [word for item in node.items for word in words_in(item)]
    return [word for entry in node.entries for part in (entry.key, entry.value) for word in words_in(part)]


EVERYTHING = {"protocol": PROTOCOL, "run": RUN, "device": DEVICE, "vectors": VECTORS, "memory": MEMORY}
WORDS = sorted({word for text in EVERYTHING.values() for word in words_in(read_text(text, "f")) if len(word) > 1})


@settings(max_examples=80, deadline=None)
@given(
    st.sampled_from(sorted(EVERYTHING)),
    st.sampled_from(WORDS),
    st.sampled_from(["zzz", "{a: b}", "[a]", "''", "f(a, b)", "'a b'", "12", "{}", "[]"]),
)
def test_whatever_is_changed_gives_our_own_words_at_places_in_the_file(kind: str, word: str, other: str) -> None:
    text = EVERYTHING[kind].replace(word, other, 3)
    try:
        node = read_text(text, "f")
    except DefinitionError:
        return
    found = validate(node, kind)  # type: ignore[arg-type]
    assert found == sorted(set(found)) == validate(node, kind)  # type: ignore[arg-type]
    lines = text.splitlines()
    for problem in found:
        assert not any(raw in problem.what for raw in RAW_WORDS)
        assert problem.at.column <= len(lines[problem.at.line - 1]) + 1


def test_a_mapping_made_by_hand_is_validated_too() -> None:
    node = read_text("protocol: p\n", "f")
    assert isinstance(node, Mapping)
    assert validate(Mapping(node.entries, node.at), "protocol") == []
