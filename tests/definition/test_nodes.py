"""YAML to nodes: positions, texts that stay texts, and all refusals."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from framekit.definition import nodes
from framekit.definition.nodes import Entry, Mapping, Node, Scalar, Sequence, read_nodes, read_text
from framekit.definition.problems import DefinitionError, Position


def at(line: int, column: int) -> Position:
    return Position("f", line, column)


def problems_of(text: str) -> list[str]:
    with pytest.raises(DefinitionError) as caught:
        read_text(text, "f")
    return [str(problem) for problem in caught.value.problems]


def scalars_of(node: Node) -> list[Scalar]:
    if isinstance(node, Scalar):
        return [node]
    if isinstance(node, Sequence):
        return [scalar for item in node.items for scalar in scalars_of(item)]
    return [scalar for entry in node.entries for part in (entry.key, entry.value) for scalar in scalars_of(part)]


# ---- what is read -------------------------------------------------------------------------------------------


def test_nodes_carry_their_positions() -> None:
    node = read_text("a: 1\nb:\n  - x\n  - {c: 'd'}\n", "f")
    inner = Mapping((Entry(Scalar("c", at(4, 6)), Scalar("d", at(4, 9), quoted=True)),), at(4, 5), flow=True)
    assert node == Mapping(
        (
            Entry(Scalar("a", at(1, 1)), Scalar("1", at(1, 4))),
            Entry(Scalar("b", at(2, 1)), Sequence((Scalar("x", at(3, 5)), inner), at(3, 3))),
        ),
        at(1, 1),
    )


def test_columns_count_characters_not_bytes() -> None:
    node = read_text("ärger: {größe: x, y}\n", "f")
    assert isinstance(node, Mapping)
    inner = node.get("ärger")
    assert isinstance(inner, Mapping)
    assert inner.get("größe") == Scalar("x", at(1, 16))
    assert inner.get("y") == Scalar("", at(1, 20), absent=True)


@pytest.mark.parametrize(
    "text", ["010", "on", "NO", "12:30", "0x1F", "~", "null", "1.5", "2010-03-01", "1_000", "=", ".inf"]
)
def test_scalars_stay_the_text_they_are(text: str) -> None:
    node = read_text(f"{text}: {text}\n", "f")
    assert isinstance(node, Mapping)
    assert node.keys() == (text,)
    assert node.get(text) == Scalar(text, at(1, len(text) + 3))


def test_mappings_are_asked_by_key() -> None:
    node = read_text("{a: 1, b: 2}", "f")
    assert isinstance(node, Mapping)
    assert node.keys() == ("a", "b")
    assert "a" in node and "c" not in node
    assert node.get("c") is None
    assert node.flow


def test_quotes_are_told() -> None:
    node = read_text("[a, 'b', \"c\", '']", "f")
    assert [scalar.quoted for scalar in scalars_of(node)] == [False, True, True, True]


def test_block_texts_are_not_quoted() -> None:
    node = read_text("a: >-\n  one\n  two\nb: |\n  three\n", "f")
    assert [(scalar.text, scalar.quoted) for scalar in scalars_of(node)] == [
        ("a", False),
        ("one two", False),
        ("b", False),
        ("three\n", False),
    ]


@pytest.mark.parametrize(
    ("text", "absent"),
    [
        ("a:\n", False),
        ("{a: }", False),
        ("{a}", True),
        ("{'a':}", False),
        ("{b: 1, a}", True),
        ("{a : }", False),
        ("? a\n", True),
    ],
)
def test_a_value_is_absent_when_there_is_not_even_a_colon(text: str, absent: bool) -> None:
    node = read_text(text, "f")
    assert isinstance(node, Mapping)
    value = node.entries[-1].value
    assert isinstance(value, Scalar)
    assert (value.text, value.quoted, value.absent) == ("", False, absent)


def test_an_expression_cut_at_its_comma_leaves_an_absent_value() -> None:
    node = read_text("{set: max(a, b)}", "f")
    assert isinstance(node, Mapping)
    assert [(entry.key.text, entry.value) for entry in node.entries] == [
        ("set", Scalar("max(a", at(1, 7))),
        ("b)", Scalar("", at(1, 16), absent=True)),
    ]


def test_aliases_repeat_what_they_name() -> None:
    node = read_text("a: &x [1, 2]\nb: *x\n", "f")
    assert isinstance(node, Mapping)
    assert node.get("b") is node.get("a")


def test_a_byte_order_mark_is_nothing() -> None:
    node = read_text("\ufeffa: 1\n", "f")
    assert isinstance(node, Mapping)
    assert node.entries[0].key.at == at(1, 1)


# ---- what is refused ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "what", "todo"),
    [
        ("", "f:1:1: the file is empty", "begin with protocol: NAME"),
        ("# nothing\n", "f:1:1: the file is empty", "begin with protocol: NAME"),
        ("---\n", "f:1:1: the file is empty", "begin with protocol: NAME"),
        ("a: 1\na: 2\n", "f:2:1: the key 'a' stands here twice, first in line 1", "remove one of them"),
        ("{a: 1, b: max(c, b}", "f:1:18: the key 'b' stands here twice, first in line 1", "quote the whole expression"),
        ("[a]: 1\n", "f:1:1: a list cannot be a key", ""),
        ("{{a}: 1}", "f:1:2: a mapping cannot be a key", "put the whole expression in quotes"),
        (
            "a: !!str 1\n",
            "f:1:4: the tag '!!str' has no meaning here",
            "remove it, or quote the value if '!' belongs to it",
        ),
        (
            "a: !x {b: 1}\n",
            "f:1:4: the tag '!x' has no meaning here",
            "remove it, or quote the value if '!' belongs to it",
        ),
        (
            "a: &a {b: 1}\nc:\n  <<: *a\n",
            "f:3:3: merge keys (<<) are not known here",
            "write the keys out, or use extends:",
        ),
        ("a: 1\n---\nb: 2\n", "f:2:1: a second document begins here", "keep one document a file"),
        ("a: *b\n", "f:1:4: there is no '&b' that '*b' could repeat", "quote the value if '*' belongs to it"),
        ("a: &a\n  b: *a\n", "f:2:6: '*a' stands inside what it repeats", "write out what is meant"),
        ("a: x\x07y\n", "f:1:5: the character U+0007 cannot stand in YAML", "remove it; bytes are written as hex"),
    ],
)
def test_refused(text: str, what: str, todo: str) -> None:
    assert problems_of(text) == [f"{what} – {todo}" if todo else what]


def test_a_quoted_merge_key_is_a_key() -> None:
    node = read_text("'<<': 1\n", "f")
    assert isinstance(node, Mapping)
    assert node.keys() == ("<<",)


def test_what_can_be_told_together_is_told_together() -> None:
    found = problems_of("a: !x 1\na: 2\n[b]: 3\n<<: 4\nc: *d\ne: [1\n")
    assert [problem.split(":")[1] for problem in found] == ["1", "2", "3", "4", "5", "6"]


@pytest.mark.parametrize(
    ("text", "what", "todo"),
    [
        ("a: {when: x[0] == 1, then: end}\n", "f:1:12: the value is cut at '['", "quote the whole expression"),
        ("a:\n  {when: 1,\n   size: max{1}}\n", "f:3:13: the value is cut at '{'", "quote the whole expression"),
        ("a: {when: [1] == x}\n", "f:1:15: the value goes on behind ']'", "quote the whole expression"),
        ("a: {when: 'x' in b}\n", "f:1:15: the value goes on behind its closing quote", "quote the whole expression"),
        (
            "a: 'ON' if x else 'OFF'\n",
            "f:1:9: the value goes on behind its closing quote",
            "quote the whole expression",
        ),
        ("- 'a' b\n", "f:1:7: the value goes on behind its closing quote", "quote the whole expression"),
        ("a: [1] + x\n", "f:1:8: the value goes on behind ']'", "quote the whole expression"),
        ("a: {b: 1\nc: 2\n", "f:1:4: the '{' here is not closed", "add '}', or quote the whole expression"),
        ("a: [1}\n", "f:1:6: '}' stands where ']' is missing", "close '[' with ']'"),
        ("a: [1]]\n", "f:1:7: there is a ']' too many", "remove it"),
        ("a: 1\nb: ]\n", "f:2:4: there is a ']' too many", "remove it, or put the value in quotes"),
        ("a: [,1]\n", "f:1:5: a value is missing before ','", "write one, or put the whole value in quotes"),
        ("a: [\n", "f:2:1: a value is missing at the end of the file", "write one, or put the whole value in quotes"),
        (
            "a: [- b]\n",
            "f:1:5: a list written with '- ' cannot stand between brackets",
            "write [a, b], or use no brackets",
        ),
        ("a: b: c\n", "f:1:5: a second ': ' stands in this value", "quote the whole value"),
        (
            "a: 1\n  b: 2\n",
            "f:2:3: this line does not fit the one above",
            "check its indentation, and the ':' of the line above",
        ),
        (
            "a:\n    b: 1\n  c: 2\n",
            "f:3:3: this line is indented like none above it",
            "indent it like the keys it belongs to",
        ),
        (
            "a:\n  - b\n  c: 1\n",
            "f:3:3: this line stands where an item of a list is wanted",
            "begin it with '- ' or indent it otherwise",
        ),
        ("a: 'b\n", "f:1:4: the quote that opens here is not closed", "add the closing quote"),
        ('a: "\\q"\n', "f:1:5: a '\\' in double quotes changes what follows", "use single quotes, or write \\\\"),
        ("a: {of:[b]}\n", "f:1:7: a space is missing behind ':'", "write key: value"),
        ("a: %MW100\n", "f:1:4: a value cannot begin with '%'", "put it in quotes"),
        ("a: @x\n", "f:1:4: a value cannot begin with '@'", "put it in quotes"),
        ("a: * b\n", "f:1:4: a value cannot begin with '*'", "put it in quotes"),
        ("a: > 3\n", "f:1:4: a value cannot begin with '>'", "put it in quotes"),
        ("a: !e!x 1\n", "f:1:4: a value cannot begin with '!'", "put it in quotes"),
        ("a:\n\tb: 1\n", "f:2:1: a tab stands here", "indent with spaces"),
        ("a: 1\n...\nb: 2\n", "f:3:1: something stands behind the end of the document", "remove the '...' above"),
    ],
)
def test_syntax_errors_say_what_to_do(text: str, what: str, todo: str) -> None:
    assert problems_of(text) == [f"{what} – {todo}"]


SYNTAX_ERRORS = [
    "a: {b: x[0]}\n",
    "a: 'x' in b\n",
    "a: b: c\n",
    "a: {b: 1\nc: 2\n",
    "a: %x\n",
    "a: 'b\n",
    "a:\n\tb: 1\n",
]


@pytest.mark.parametrize("text", SYNTAX_ERRORS)
def test_the_python_scanner_is_understood_too(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with_c = problems_of(text)
    monkeypatch.setattr(nodes, "_LOADER", yaml.SafeLoader)
    assert problems_of(text) == with_c


# ---- files and limits ---------------------------------------------------------------------------------------


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    missing, folder = "there is no such file", "this is a folder, not a file"
    for path, what, line in [(tmp_path / "no.yaml", missing, 0), (tmp_path, folder, 0)]:
        with pytest.raises(DefinitionError) as caught:
            read_nodes(path)
        found = [(problem.at, problem.what) for problem in caught.value.problems]
        assert found == [(Position(str(path), line, line), what)]


def test_a_file_that_is_not_utf8(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes("a: ü\nb: ä ".encode() + b"\xe4\n")
    with pytest.raises(DefinitionError) as caught:
        read_nodes(path)
    assert str(caught.value) == f"{path}:2:6: the byte E4 is not UTF-8 – save the file as UTF-8"


def test_a_file_reads_like_its_text(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("a: [1, ü]\n", encoding="utf-8")
    assert read_nodes(path) == read_text("a: [1, ü]\n", str(path))


def test_files_larger_than_4_megabytes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    path.write_bytes(b"#" * ((4 << 20) + 1))
    with pytest.raises(DefinitionError, match="larger than 4 MB"):
        read_nodes(path)
    with pytest.raises(DefinitionError, match="larger than 4 MB"):
        read_text("#" * ((4 << 20) + 1), "f")


def test_nesting_is_limited() -> None:
    assert isinstance(read_text("[" * 64 + "]" * 64, "f"), Sequence)
    assert problems_of("[" * 65 + "]" * 65) == [
        "f:1:65: this is nested deeper than 64 – give parts of it names of their own"
    ]
    assert "deeper than 64" in problems_of("[" * 100_000)[0]


def test_nesting_by_aliases_is_limited() -> None:
    text = "a: &a " + "[" * 40 + "]" * 40 + "\nb: " + "[" * 30 + "*a" + "]" * 30 + "\n"
    assert problems_of(text) == ["f:2:34: with this alias the file is nested deeper than 64 – write out what is meant"]


def test_an_alias_bomb_is_refused() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 10)]
    (problem,) = problems_of("\n".join(lines) + "\n")
    assert "with this alias the file has more than 100000 parts" in problem


def test_aliases_below_the_limit_are_fine() -> None:
    items = ", ".join(["x"] * 1000)
    node = read_text(f"a: &a [{items}]\n" + "".join(f"b{n}: *a\n" for n in range(90)), "f")
    assert len(scalars_of(node)) == 91 + 91_000


# ---- anything -----------------------------------------------------------------------------------------------

PIECES = st.sampled_from([*"{}[]:,'\"#&*!|>%@-? \n\tab1()<\\~", ": ", "- ", "\n  ", "a: ", "<<: ", "&a ", "*a"])


@settings(max_examples=300, deadline=None)
@given(st.lists(PIECES, max_size=25).map("".join))
def test_any_text_gives_nodes_or_problems_inside_it(text: str) -> None:
    try:
        node = read_text(text, "f")
    except DefinitionError as error:
        places = [problem.at for problem in error.problems]
        assert all(problem.what and "expected" not in problem.what for problem in error.problems)
    else:
        places = [scalar.at for scalar in scalars_of(node)]
    lines = text.count("\n") + 2
    assert all(1 <= place.line <= lines and place.column >= 1 for place in places)


VALUES = st.recursive(
    st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF, exclude_categories=["Cc", "Cs"]), max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abcdef", min_size=1), inner, max_size=3),
    max_leaves=12,
)


def plain(node: Node) -> object:
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return {entry.key.text: plain(entry.value) for entry in node.entries}
    return [plain(item) for item in node.items]


@settings(max_examples=100, deadline=None)
@given(VALUES, st.booleans())
def test_what_was_written_is_read(value: object, flow: bool) -> None:
    text = yaml.safe_dump({"a": value}, default_flow_style=flow, allow_unicode=True)
    assert plain(read_text(text, "f")) == {"a": value}
