"""Imported Kaitai Struct descriptions read the values that Kaitai reads, and report what they cannot express."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import pytest
from extras.kaitai.kaitai_world import needs_compiler
from extras.kaitai.ksy_world import KSY, Description, RoundTrip, loaded, round_trip
from shipped import APPLICATIONS, PROTOCOLS
from spread import WHOLE, many, spread

from framekit.api.check import check_file
from framekit.definition.load.protocol import load_protocol
from framekit.definition.nodes import MOST_EXPANDED
from framekit.definition.problems import DefinitionError, Problem
from framekit.extras.kaitai import importing
from framekit.extras.kaitai.attributes import MOST_WORK, WorkDone
from framekit.extras.kaitai.importing import import_kaitai

TLV = "07 03 00 00 00 01 02 12 34 02 03 61 62 00 03 05 00 01 AA BB CC 09 01 55"
"""The size of the text follows from an enclosing length: such a frame can be read, not built."""
DESCRIPTIONS = [
    Description("meter", "meter", ("magic", "is_heat")),
    Description("tlv", "tlv", ("end",), seed=TLV),
    Description("bits", "bits"),
    Description("strings", "strings", ("sign",)),
    Description("lists", "lists", ("number",), seed="01000005410001020304810507010102 01FF0901020307 08"),
    Description("conditions", "conditions"),
    Description("rest", "rest"),
    Description("choices", "choices"),
    Description("names", "names", ("magic", "how", "same")),
    Description("messages", "ask", ("code",), (("Which", "ask"), 100, False), {"limit": 100, "strict": False}),
    Description("messages", "tell", ("code",), (("Which", "tell"), 100, False), {"limit": 100, "strict": False}),
    Description("messages", "tell", ("code",), (("Which", "tell"), 100, True), {"limit": 100, "strict": True}),
]
"""Kaitai files with their tops; constants and parameters are left out of the comparison."""
FILES = sorted(KSY.glob("*.ksy"))


def imported(text: str, folder: Path) -> list[Problem]:
    """Import a text and check the result with `framekit check`; return the reported problems."""
    made = import_kaitai(text, "some.ksy", "some")
    path = folder / "some.yaml"
    path.write_text(made.text, "utf-8")
    assert [problem for problem in check_file(str(path)).problems if not problem.warning] == []
    return [*made.left_out]


def messages_of(text: str, folder: Path) -> list[str]:
    try:
        problems = imported(text, folder)
    except DefinitionError as error:
        problems = [*error.problems]
    return [str(problem).removeprefix("some.ksy:") for problem in problems]


# ---- beside Kaitai ----------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("one", spread(DESCRIPTIONS, 3), ids=lambda one: f"{one.name}-{one.frame}")
def test_the_same_bytes_have_the_same_values(one: Description, tmp_path: Path) -> None:
    found = one.trial(tmp_path, 600)
    assert found.differences == []
    assert found.both >= 150 and found.refused >= 15


@needs_compiler
@pytest.mark.long
@pytest.mark.parametrize("one", DESCRIPTIONS, ids=lambda one: f"{one.name}-{one.frame}")
def test_many_bytes_have_the_same_values(one: Description, tmp_path: Path) -> None:
    assert one.trial(tmp_path, many(1_500, 4_000)).differences == []


# ---- exported and imported --------------------------------------------------------------------------------------

QUICK = ("modbus-rtu", "host-link", "mewtocol")
ALL = [*PROTOCOLS, *APPLICATIONS]


def come_back(name: str, folder: Path) -> RoundTrip:
    """Export and re-import a definition; assert that the copy reads the frames that the original builds."""
    found = round_trip(name, folder)
    assert found.compared.differences == []
    # frames that no byte distinguishes, and parts under an inexpressible condition, are reported as refused
    assert {message.partition(" ")[0] for message in found.refused} <= {
        "request_frame", "reply_frame", "rsp_ud", "task", "response",
    }  # fmt: skip
    if found.imported:
        assert found.compared.agreed or found.compared.left_out
        assert [problem for problem in check_file(str(folder / "made.yaml")).problems if not problem.warning] == []
    return found


@pytest.mark.parametrize("name", QUICK)
def test_exported_definitions_come_back(name: str, tmp_path: Path) -> None:
    assert come_back(name, tmp_path).imported


@pytest.mark.long
@pytest.mark.parametrize("name", spread(ALL, len(ALL), first=len(ALL), part=5))
def test_more_exported_definitions_come_back(name: str, tmp_path: Path) -> None:
    if not load_protocol(name).frames:
        pytest.skip("no frames")
    come_back(name, tmp_path)


@pytest.mark.skipif(not WHOLE, reason="FRAMEKIT_WHOLE asks for it: 100 s")
@pytest.mark.long(minutes=5)
def test_all_exported_definitions_come_back_as_the_page_says(tmp_path: Path) -> None:
    sums: Counter[str] = Counter()
    for name in (name for name in ALL if load_protocol(name).frames):
        found = come_back(name, tmp_path)
        sums.update(exported=found.exported, imported=len(found.imported), frames=found.compared.frames)
        sums.update(agreed=found.compared.agreed, refused=len(found.refused))
    page = " ".join((Path(__file__).parents[3] / "docs/howto/import-kaitai.md").read_text("utf-8").split())
    assert f"{sums['imported']:,} of the {sums['exported']:,} frames" in page
    for count, of in ((sums["frames"], "samples"), (sums["agreed"], "values")):
        assert f"more than {count // 1000 * 1000:,} {of}" in page
    assert f"{sums['refused']} samples" in page


# ---- what is told -----------------------------------------------------------------------------------------------


def test_the_samples_pass_the_check(tmp_path: Path) -> None:
    for path in FILES:
        assert not any("frame '" in problem.what for problem in imported(path.read_text("utf-8"), tmp_path)), path


UNSAYABLE = """\
meta: {id: odd, endian: be, imports: [other], license: MIT}
seq:
  - {id: kind, type: u1}
  - id: packed
    size: 4
    process: xor(0x5a)
  - {id: opaque, type: elsewhere, if: kind == 1}
  - id: body
    size: 3
    type: {switch-on: kind, cases: {2: known, 3: unknown}}
  - {id: rate, type: u1, -orig-id: RATE}
types:
  known: {seq: [{id: x, type: u1}]}
instances:
  late: {pos: 4, type: u2}
  half: {value: rate * 0.5}
  whole: {value: rate * 2}
"""


def test_what_cannot_be_said_is_told_with_its_place(tmp_path: Path) -> None:
    assert messages_of(UNSAYABLE, tmp_path) == [
        "1:38: what imports: names is left out – put its types into this file",
        "1:47: warning: meta/license is left out – a definition has no place for it",
        "4:5: the bytes of 'packed' stay as they are, as 'packed_raw' – write by hand what is in them",
        "6:14: how 'packed' is coded – a wrap: may say it",
        "7:5: a frame in which 'opaque' is there is refused – see what is told of it",
        "7:24: the type 'elsewhere', which is not in this file, – write it into this file",
        "10:50: a frame with the case '3' of 'body' is refused – see what is told of it",
        "10:50: the type 'unknown', which is not in this file, – write it into this file",
        "11:36: warning: the key '-orig-id' is left out – Kaitai passes over it too",
        "15:9: the instance 'late' is left out: it stands at a place of its own"
        " – a definition reads bytes in their order",
        "16:17: a number with a fraction is left out – write what it means by hand",
    ]
    codec = loaded(import_kaitai(UNSAYABLE, "some.ksy", "some"), tmp_path)
    frame = codec.frames["odd"]
    assert frame.decode(bytes.fromhex("02 01020304 050607 08"), {}) == {
        "kind": 2, "packed_raw": b"\x01\x02\x03\x04", "body": {"x": 5}, "body_rest": b"\x06\x07", "rate": 8,
        "whole": 16,
    }  # fmt: skip
    for kind in ("01", "03"):
        with pytest.raises(ValueError, match="require"):
            frame.decode(bytes.fromhex(f"{kind} 01020304 050607 08"), {})


PARTS = {
    "{id: a, type: b4}, {id: b, type: u1, if: a == 1}": "within a byte",
    "{id: a, type: b4}, {id: b, type: b4le}": "counted otherwise",
    "{id: a, type: u2}": "the byte order",
    "{id: a, type: str, size: 3}": "the encoding",
    "{id: a, type: str, size: 3, encoding: UTF-16LE}": "a text in UTF-16LE",
    "{id: a, type: strz, encoding: ASCII, include: true}": "with its terminator",
    "{id: a, size-eos: true}, {id: b, type: u1}": "something may stand behind it",
    "{id: a, size: _io.size - 1}": "no places in a stream",
    "{id: a, size: _io.size - _io.pos - 2}, {id: b, type: u1}": "where 'a' ends",
    "{id: a, type: u1}, {id: b, size: 1 << a, if: a == 1}": "",
    "{id: a, type: u2le}, {id: b, size: 1 << a}": "a shift",
    "{id: a, type: u1}, {id: b, size: a / 2.0}": "a fraction",
    "{id: a, type: t}": "stands in itself",
    "{id: a, type: u1, enum: none}": "no enumeration 'none'",
    "{id: a, type: u1, valid: 1.5}": "a fraction",
    "{id: a, type: u1, foo: 1}": "the key 'foo'",
    "{id: a, type: u1}, {id: b, type: u1, if: a}": "of another kind",
    "{id: a, size: 4, pad-right: 0}": "the filling",
    "{id: a, size: 4, process: zlib}": "how 'a' is coded",
    "{id: a, size: 4, type: other}": "the type 'other'",
    "{id: a, size: 1, type: two}": "more bytes than the 1 there are",
    "{id: a, type: u1, repeat: eos}, {id: b, type: u1}": "may stand behind it",
    "{id: a, size: 0, repeat: eos}": "take no bytes",
    "{id: a, type: u1, if: a == 1}": "left out or read later",
    "{id: A, type: u1}": "cannot be a name here",
    "{id: a, size: 2000000}": "a size of 2000000 bytes",
    "{id: a, type: {switch-on: 1, cases: {x: u1}}}": "'x'",
    "{id: a, contents: [010]}": "the number 010 is another one in YAML 1.1 than in 1.2",
    "{id: a, contents: [1:10]}": "the number 1:10 is another one",
    "{id: a, contents: [0o10]}": "a text in YAML 1.1",
    "{id: a, contents: ['256']}": "no byte and no text",
    "{id: a, size: 0_10}": "the number 0_10 is another one",
    "{id: a, type: strz, encoding: ASCII, terminator: 012}": "the number 012 is another one",
    "{id: a, type: u1, valid: 010}": "the number 010 is another one",
    "{id: a, type: u1, valid: '010'}": "",
    "{id: a, type: u1, valid: 007}": "",
    "{id: a, type: {switch-on: 1, cases: {010: u1}}}": "the number 010 is another one",
    "{id: a, type: strz, encoding: ASCII, valid: '\"\\q\"'}": "an escape that Kaitai does not have",
    "{id: a, type: strz, encoding: ASCII, valid: '\"\\77777777\"'}": "an escape that Kaitai does not have",
}


@pytest.mark.parametrize("seq", PARTS)
def test_each_part_that_has_no_form_is_told(seq: str, tmp_path: Path) -> None:
    types = "types: {t: {seq: [{id: again, type: t}]}, two: {seq: [{id: x, size: 2}]}}"
    found = messages_of(f"meta: {{id: odd}}\nseq: [{seq}]\n{types}\n", tmp_path)
    assert any(PARTS[seq] in message for message in found) if PARTS[seq] else found == []
    if "pad-right" not in seq and PARTS[seq] and "_io" not in seq:
        assert any("the frame 'odd' is left out" in message or "is refused" in message for message in found)


def test_what_cases_of_one_type_say_differently_is_told(tmp_path: Path) -> None:
    text = """\
meta: {id: odd}
seq: [{id: kind, type: u1}, {id: body, type: {switch-on: kind, cases: {1: outer(1), 2: outer(2)}}}]
types:
  outer: {params: [{id: n, type: u1}], seq: [{id: x, type: inner(n + 1)}]}
  inner: {params: [{id: m, type: u1}], seq: [{id: y, type: u1}]}
instances: {a: {value: body.as<outer>.n}, b: {value: body.as<outer>.x.m}, c: {value: body.as<outer>.x.y}}
"""
    assert messages_of(text, tmp_path) == [
        f"6:{column}: '{name}', which is another one in each case, is left out – write what it means by hand"
        for column, name in ((24, "n"), (54, "m"))
    ]


def test_other_numbers_of_an_enumeration_and_instances_in_no_frame_are_told(tmp_path: Path) -> None:
    text = """\
meta: {id: odd}
types: {t: {seq: [{id: x, type: u1, enum: e}]}}
enums: {e: {010: eight, 9: nine}}
instances: {late: {pos: 0, type: t}}
"""
    assert messages_of(text, tmp_path) == [
        "3:13: the number 010 is another one in YAML 1.1 than in 1.2"
        " – write it in base 10 or 16, without zeros before it",
        "4:19: the instance 'late' is left out: it stands in no frame – put it into a type",
    ]


def test_a_name_inside_that_hides_one_outside_is_told(tmp_path: Path) -> None:
    text = """\
meta: {id: odd}
seq: [{id: len, type: u1}, {id: body, type: body}]
types:
  body: {seq: [{id: len, type: u1}, {id: data, size: _parent.len}]}
"""
    assert (
        "4:54: 'len' of 'odd', which 'body' has a value of its own for, is left out" in messages_of(text, tmp_path)[1]
    )


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "the file is empty"),
        ("- 1", "no description of Kaitai Struct"),
        ("meta: 3", "meta: holds no keys"),
        ("a: &x [*x]", "stands inside what it repeats"),
        ("seq: {a: 1}", "no list of attributes"),
        ("meta: {id: x}", "nothing to read"),
        ("seq: [{id: a, type: 'u1"[:22], "the quote"),
    ],
)  # fmt: skip
def test_what_is_no_description_is_told(text: str, what: str) -> None:
    with pytest.raises(DefinitionError, match=what):
        import_kaitai(text, "some.ksy", "some")


HOSTILE = """
meta: {id: in, title: "a: [b] # \\u2028 {x", endian: le}
doc: "'''\\u0085: {"
seq:
  - {id: if, type: u1, doc: "- id: x\\n  # y", enum: e}
  - {id: never, size: if}
  - {id: d, type: {switch-on: if, cases: {1: "str", "e::else": u1}}}
enums: {e: {3: else, 4: {id: "true", doc: "x: # {"}}}
instances: {own: {value: "never == [39, 92].as<bytes> ? \\"'\\\\\\\\\\" : 'h'"}}
"""


def test_texts_of_a_file_stay_texts(tmp_path: Path) -> None:
    made = import_kaitai(HOSTILE, "some # \n.ksy", "some")
    codec = loaded(made, tmp_path)
    assert codec.frames["in"].decode(bytes.fromhex("03 01 02 03 07"), {}) == {
        "if_": 3, "never_": b"\x01\x02\x03", "d": 7, "own": "h",
    }  # fmt: skip
    assert codec.frames["in"].decode(bytes.fromhex("02 27 5C"), {})["own"] == "'\\"


# ---- any text ---------------------------------------------------------------------------------------------------


def changed(draw: random.Random, texts: list[str]) -> str:
    """Return a description with a few changes: words of other files, lines removed, duplicated or moved."""
    lines = draw.choice(texts).splitlines()
    words = draw.choice(texts).split()
    for _ in range(draw.randint(1, 2)):
        place = draw.randrange(len(lines))
        match draw.randrange(5):
            case 0:
                del lines[place]
                lines = lines or [""]
            case 1:
                lines.insert(draw.randrange(len(lines)), lines[place])
            case 2:
                old = lines[place].split()
                lines[place] = lines[place].replace(draw.choice(old), draw.choice(words)) if old else draw.choice(words)
            case 3:
                cut = draw.randint(0, len(lines[place]))
                lines[place] = lines[place][:cut] + draw.choice("[]{}:#'\"&*!|>%@,?- \t\0é\u2028") + lines[place][cut:]
            case _:
                lines[place] = " " * draw.randrange(5) + lines[place].strip()
    return "\n".join(lines)


@pytest.mark.parametrize("seed", spread(range(4), 4))
def test_any_text_gives_a_definition_or_is_told(seed: int, tmp_path: Path) -> None:
    draw, texts = random.Random(seed), [path.read_text("utf-8") for path in FILES]
    made = 0
    for _ in range(50):
        text = changed(draw, texts)
        try:
            imported(text, tmp_path)
            made += 1
        except DefinitionError as error:
            assert error.problems
    assert made >= 5


def doubling(depth: int) -> str:
    types = "".join(
        f"  t{number}: {{seq: [{{id: a, type: t{number + 1}}}, {{id: b, type: t{number + 1}}}]}}\n"
        for number in range(depth)
    )
    return f"meta: {{id: odd}}\nseq: [{{id: a, type: t0}}]\ntypes:\n{types}  t{depth}: {{seq: [{{id: a, type: u1}}]}}\n"


@pytest.mark.parametrize("depth", [60, 400, 4000])
def test_instances_that_ask_for_each_other_have_a_bound(depth: int, tmp_path: Path) -> None:
    chain = "".join(f"  b{number}: {{value: b{number + 1} + 1}}\n" for number in range(depth))
    text = f"meta: {{id: odd}}\nseq: [{{id: a, type: u1}}]\ninstances:\n{chain}  b{depth}: {{value: a}}\n"
    assert "instances that ask for each other deeper than 24" in messages_of(text, tmp_path)[0]


@pytest.mark.parametrize("count", [30, 60, 101, 400, 4000])
def test_attributes_that_may_be_left_out_in_a_row_have_a_bound(count: int, tmp_path: Path) -> None:
    seq = ", ".join(f"{{id: b{number}, type: u1, if: not _io.eof}}" for number in range(count))
    found = messages_of(f"meta: {{id: odd}}\nseq: [{{id: a, type: u1}}, {seq}]\n", tmp_path)
    assert any("nested deeper" in message or "more than 100 attributes in a row" in message for message in found)


def test_types_under_conditions_too_deep_for_python_are_told(tmp_path: Path) -> None:
    types = "".join(
        f"  t{number}: {{seq: [{{id: x, type: u1}}, {{id: a, type: t{number + 1}, if: x == 1}}]}}\n"
        for number in range(23)
    )
    text = f"meta: {{id: odd}}\nseq: [{{id: a, type: t0}}]\ntypes:\n{types}  t23: {{seq: [{{id: x, type: u1}}]}}\n"
    assert (
        "the frame 'odd' is left out: parts of a frame stand too deeply inside each other"
        in messages_of(text, tmp_path)[0]
    )


def frames_of(count: int) -> str:
    parts = ", ".join(f"{{id: a{number}, type: u1}}" for number in range(200))
    cases = ", ".join(f"{number}: t{number}" for number in range(count))
    types = "".join(f"  t{number}: {{seq: [{{id: all, type: part}}]}}\n" for number in range(count))
    top = f"params: [{{id: p, type: u4}}]\nseq: [{{id: c, type: {{switch-on: p, cases: {{{cases}}}}}}}]\n"
    return f"meta: {{id: odd}}\n{top}types:\n  part: {{seq: [{parts}]}}\n{types}"


@pytest.mark.parametrize(
    "text",
    [
        doubling(15),
        doubling(40),
        frames_of(900),
        "meta: {id: odd}\nseq: [{id: a, type: u1}]\ninstances: {b: {value: " + "a + " * 2400 + "a}}\n",
        "meta: {id: odd}\nseq: [{id: a, type: u1}]\ninstances: {b: {value: " + "(" * 4000 + "a}}\n",
        "meta: {id: odd}\nseq: [{id: a, type: u1}]\ninstances:\n  b0: {value: a}\n"
        + "".join(f"  b{number + 1}: {{value: b{number} + b{number}}}\n" for number in range(300)),
        "meta: {id: odd}\nseq: [" + ", ".join(f"{{id: b{number}, type: b1}}" for number in range(3000)) + "]\n",
        "meta: {id: odd}\nx: &a [1]\nseq: [{id: a, type: u1}]\n",
    ],
    ids=["doubling", "deep", "frames", "sum", "parentheses", "chain", "bits", "alias"],
)
def test_work_is_bounded(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    counters: list[WorkDone] = []

    class Counted(WorkDone):
        def __init__(self) -> None:
            super().__init__()
            counters.append(self)

    monkeypatch.setattr(importing, "WorkDone", Counted)
    monkeypatch.setattr(importing, "_refused", lambda text: ([], []))
    try:
        made = import_kaitai(text, "some.ksy", "some")
        assert len(made.text) < 40 * MOST_WORK
    except DefinitionError as error:
        assert len(error.problems) < 2000
    assert counters[0].all <= MOST_WORK + MOST_EXPANDED
