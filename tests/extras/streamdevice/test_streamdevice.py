"""Protocol files of StreamDevice as definitions: exchanges run end to end, reported omissions, and arbitrary text."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spread import spread

import framekit
from framekit.api.check import check_file
from framekit.api.vectors import run_vectors
from framekit.cli.main import main
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError
from framekit.extras.streamdevice.importing import from_streamdevice

SUPPLY = r"""
# a supply
Terminator = CR LF;
ReplyTimeout = 500;
unit = "CURR";
current   { out "CURR?"; in "CURR %f A"; }
set       { out $unit " %.3f"; @init { current; } }
identify  { out "*IDN?"; in "%39c"; }
channel   { out "CH\$1?"; in "CH\$1=%(level)d,%(unit)s"; }
measure   { out "INIT"; wait 300; out "MEAS?"; in "%f"; }
slow      { out "GO"; wait 200; in "OK %d"; out "END"; }
switch    { out "SW?"; in "SW %{OFF|ON}"; }
turn      { out "SW %{OFF|ON}"; in "SW %{OFF|ON}"; }
status    { InTerminator = ETX; OutTerminator = ETX; ReplyTimeout = 2000; out STX "S"; in STX "%02X%04x"; }
checked   { OutTerminator = CR; InTerminator = ""; out "A%03d%0<sum8>"; in 0x06; }
version   { out "VER?"; in "%d.%d.%*d"; }
loose     { ExtraInput = Ignore; out "L?"; in "L%2c"; }
rest      { ExtraInput = Ignore; out "R?"; in "R%02x,"; }
hex       { out "H %04X"; in "H%x"; }
told      { in "EVENT %d"; }
both      { current; switch; }
set-all+1 { out "ALL"; }
extra     { ExtraInput = Ignore; out "X?"; in "X %f"; }
degrees   { out "T?"; in "%f" 0xB0 "C"; }
"""

Line = list[tuple[str, bytes]]
CONVERSATIONS: list[tuple[str, str, Line, str]] = [
    ("current", "", [("send", b"CURR?\r\n"), ("receive", b"CURR 1.25 A\r\n")], "value: 1.25"),
    ("set", "value: 2.5", [("send", b"CURR 2.500\r\n")], ""),
    ("set_init", "", [("send", b"CURR?\r\n"), ("receive", b"CURR -3 A\r\n")], "value: -3"),
    ("identify", "", [("send", b"*IDN?\r\n"), ("receive", b"Acme, model 7\r\n")], "value: 'Acme, model 7'"),
    ("channel", "arg_1: '7'", [("send", b"CH7?\r\n"), ("receive", b"CH7=-40,mV\r\n")], "level: -40, unit: mV"),
    (
        "measure", "",
        [("send", b"INIT\r\n"), ("not before 300 ms", b"MEAS?\r\n"), ("receive", b"0.5\r\n")], "value: 0.5",
    ),
    (
        "slow", "",
        [("send", b"GO\r\n"), ("receive", b"OK 3\r\n"), ("not before 200 ms", b"END\r\n")], "value: 3",
    ),
    ("switch", "", [("send", b"SW?\r\n"), ("receive", b"SW ON\r\n")], "value: 1"),
    ("turn", "value: 1", [("send", b"SW ON\r\n"), ("receive", b"SW OFF\r\n")], "value_2: 0"),
    ("status", "", [("send", b"\x02S\x03"), ("receive", b"\x02A500ff\x03")], "value: 165, value_2: 255"),
    ("checked", "value: 7", [("send", b"A007D8\r"), ("receive", b"\x06")], ""),
    ("version", "", [("send", b"VER?\r\n"), ("receive", b"1.20.3\r\n")], "value: 1, value_2: 20"),
    ("loose", "", [("send", b"L?\r\n"), ("receive", b"LAB\r\n")], "value: AB"),
    ("rest", "", [("send", b"R?\r\n"), ("receive", b"R1f,anything, even \xb0C\r\n")], "value: 31"),
    ("rest", "", [("send", b"R?\r\n"), ("receive", b"R00,\r\n")], "value: 0"),
    ("loose", "", [("send", b"L?\r\n"), ("receive", b"LA\r\n")], "value: A"),
    ("set_all_1", "", [("send", b"ALL\r\n")], ""),
    ("extra", "", [("send", b"X?\r\n"), ("receive", b"X 1.5\r\n")], "value: 1.5"),
    ("hex", "value: 255", [("send", b"H 00FF\r\n"), ("receive", b"H00aB\r\n")], "value_2: 171"),
    ("told", "", [("receive", b"EVENT 5\r\n")], "value: 5"),
    (
        "both", "",
        [("send", b"CURR?\r\n"), ("receive", b"CURR 1 A\r\n"), ("send", b"SW?\r\n"), ("receive", b"SW ON\r\n")],
        "value: 1, value_2: 1",
    ),
    ("degrees", "", [("send", b"T?\r\n"), ("receive", b"21.5\xb0C\r\n")], "value: 21.5"),
]  # fmt: skip
"""A service, its arguments, the exchange as StreamDevice has it, and its result."""
FAILURES: list[tuple[str, str, Line, str]] = [
    ("current", "", [("send", b"CURR?\r\n")], "no_reply"),
    ("current", "", [("send", b"CURR?\r\n"), ("receive", b"CURR 1.5 V\r\n")], "damaged_reply"),
    ("current", "", [("send", b"CURR?\r\n"), ("receive", b"CURR +1.5 A\r\n")], "damaged_reply"),
    ("channel", "arg_1: '7'", [("send", b"CH7?\r\n"), ("receive", b"CH8=1,mV\r\n")], "damaged_reply"),
    ("channel", "arg_1: '7'", [("send", b"CH7?\r\n"), ("receive", b"CH7=1,m V\r\n")], "damaged_reply"),
    ("switch", "", [("send", b"SW?\r\n"), ("receive", b"SW NO\r\n")], "damaged_reply"),
    ("extra", "", [("send", b"X?\r\n"), ("receive", b"X 1.5 V\r\n")], "damaged_reply"),
    ("hex", "value: 1", [("send", b"H 0001\r\n"), ("receive", b"H0x1\r\n")], "damaged_reply"),
    ("both", "", [("send", b"CURR?\r\n"), ("receive", b"CURR 1 A\r\n"), ("send", b"SW?\r\n")], "no_reply"),
]
"""A service, its arguments, the exchange, and its error."""


def made_of(text: str, folder: Path) -> Path:
    (folder / "made.yaml").write_text(from_streamdevice(text, "x.proto", "made").text, "utf-8")
    return folder / "made.yaml"


def script(line: Line) -> str:
    entries = []
    for word, data in line:
        wait = f", not_before: {word.removeprefix('not before ')}" if word.startswith("not") else ""
        entries.append(f"{{{'send' if wait else word}: {data.hex(' ')}{wait}}}")
    return ", ".join(entries)


def test_exchanges_have_the_bytes_of_stream_device(tmp_path: Path) -> None:
    path = made_of(SUPPLY, tmp_path)
    lines = ["vectors: made", "conversations:"]
    for service, arguments, line, result in CONVERSATIONS:
        case = f"name: {service}, role: client, do: {{{service}: {{{arguments}}}}}, script: [{script(line)}]"
        lines.append(f"  - {{{case}, result: {{values: {{{result}}}}}}}")
    for service, arguments, line, outcome in FAILURES:
        case = f"name: {service}, role: client, do: {{{service}: {{{arguments}}}}}, script: [{script(line)}]"
        lines.append(f"  - {{{case}, result: {{outcome: {outcome}}}}}")
    (tmp_path / "made.vectors.yaml").write_text("\n".join(lines) + "\n", "utf-8")
    cases = list(run_vectors(path))
    assert [problem for case in cases for problem in case.problems] == []
    assert len(cases) == len(CONVERSATIONS) + len(FAILURES)
    assert check_warnings(path) == []


def check_warnings(path: Path) -> list[str]:
    """Return the messages of `check`, except on the strength of the device's own check code."""
    return [str(problem) for problem in check_file(str(path)).problems if "errors of two bits" not in str(problem)]


def test_a_client_speaks_with_a_device_made_of_the_same_file(tmp_path: Path) -> None:
    path = made_of(SUPPLY, tmp_path)
    (tmp_path / "supply.device.yaml").write_text("device: supply\nprotocol: made.yaml\n", "utf-8")
    seen: list[bytes] = []
    with framekit.connect(
        path, f"sim:{tmp_path / 'supply.device.yaml'}", monitor=lambda one: seen.append(one.raw)
    ) as client:
        assert client.call("current").results == {"value": 0}
        assert client.call("channel", {"arg_1": "7"}).results == {"level": 0, "unit": ""}
        assert client.call("switch").results == {"value": 0}
        client.call("set", {"value": 2.5})
    assert b"CURR 2.500\r\n" in seen and b"CH7?\r\n" in seen


def messages_of(text: str) -> list[str]:
    """Return the messages for a file: omitted parts, or errors."""
    try:
        return [str(problem) for problem in from_streamdevice(text, "x.proto", "made").left_out]
    except DefinitionError as error:
        return [str(problem) for problem in error.problems]


def test_what_is_left_out_is_told_with_its_place() -> None:
    lines = [
        'Terminator = CR; Separator = ","; PollPeriod = 500;',
        '@mismatch { in "E%d"; }',
        'a { out "A"; in "%b"; }',
        'b { out "B"; @init { event; } }',
        'c { event(1) 100; out "C"; disconnect; }',
        "d { a; }",
        'e { in "%3d"; in "%3d%5f,%f"; @replytimeout { out "again"; } }',
        "f { }",
        'g { MaxInput = 5; in "x"; }',
        'h { InTerminator = ""; ExtraInput = Ignore; out "x"; in "%2c"; }',
        'i { ReplyTimeout = soon; out "x"; in "y"; }',
        'j { out "J"; in "\\$1"; }',
    ]
    assert messages_of("\n".join(lines)) == [
        "x.proto:1:18: warning: the setting Separator – only lists have it: write repeat: with a separator where a "
        "protocol reads or writes a list",
        "x.proto:1:35: warning: the setting PollPeriod – say in a run how often a value is read",
        "x.proto:2:1: the handler @mismatch: a failed exchange ends here – write a sequence that does it",
        "x.proto:3:18: %b: no segment is like it: 'a' is left out – write its frames by hand",
        "x.proto:3:18: %b: no segment is like it: 'd' is left out – write its frames by hand",
        "x.proto:4:22: the command event, which no definition has: the handler @init of 'b' is left out – write what "
        "the device needs by hand",
        "x.proto:5:5: the command event, which no definition has: protocol 'c' is left out – write what the device "
        "needs by hand",
        "x.proto:5:28: the command disconnect, which no definition has: protocol 'c' is left out – write what the "
        "device needs by hand",
        "x.proto:7:9: warning: a width is the exact number of characters: shorter and longer texts are refused (and at "
        "2 more places) – write end: in place of size: if the device's width varies",
        "x.proto:7:9: warning: numbers are taken as -12 or 1.5; with a plus sign, an exponent, or spaces or zeros in "
        "front they are bad (and at 3 more places) – say by sign:, digits:, pad: or exponent: how the device writes "
        "them",
        "x.proto:7:31: the handler @replytimeout: a failed exchange ends here – write a sequence that does it",
        "x.proto:8:1: 'f' sends and takes nothing: it is left out – write out",
        "x.proto:9:19: MaxInput 5 beside a terminator: either ends what is read: 'g' is left out – remove one of them",
        "x.proto:10:54: ExtraInput without a terminator: nothing ends what is passed over: 'h' is left out – write "
        "its frames by hand",
        "x.proto:11:5: 'soon' is no number of milliseconds or bytes: protocol 'i' is left out – write such a number",
        "x.proto:12:14: an argument is taken that nothing before sends: 'j' is left out – write the reply by hand",
    ]


def test_a_command_without_any_terminator_is_told_once() -> None:
    (one,) = messages_of('a { out "A"; in "B"; }')
    assert one == (
        "x.proto:1:5: warning: no terminator is set for this command (and at 1 more place): the IOC may set one for "
        "the port – write Terminator = …; at the head of the file"
    )
    assert messages_of('Terminator = ""; MaxInput = 1; a { out "A"; in "B"; }') == []


@pytest.mark.parametrize(
    ("text", "wire"),
    [
        ('f = "FREQ"; p { out $f " %d" 1; }', b"FREQ 5\x01\r"),
        ('f = "FREQ"; p { out ${f}"?%d;"; }', b"FREQ?5;\r"),
        ('F = "A" 2 "B"; g = $f "C"; p { out $g "%d"; }', b"A\x02BC5\r"),
        ('f = "A"; p { f = "B"; out $f "%d"; }', b"B5\r"),
        ('p { out $f "%d"; f = "B"; }', b"B5\r"),
        ('f = "A"; p { out $f "%d"; } f = "C";', b"A5\r"),
        ('n = 12; p { out "CH\\$n %d"; }', b"CH12 5\r"),
        ('n = 12; p { out "CH\\${n}%d,"; }', b"CH125,\r"),
        ('f = "A"; p { out "<\\${f}>%d"; }', b'<"A">5\r'),
        ('f = \'it"s\'; p { out "\\${f}%d"; }', b"'it\"s'5\r"),
        ('q { Terminator = LF; out "Q%d"; } p { q; }', b"Q5\r"),
        ('p { OutTerminator = CR, LF; out "%d"; }', b"5\r\n"),
        ('P { OUT "a" , \'b"\' 0x41 0101 -1 "%d"; }', b'ab"AA\xff5\r'),
        ('p { out "\\x41\\101\\0101\\r\\e\\\\\\"%%\\%%d" }', b'AeA\r\x1b\\"%%5\r'),
        ('d = "%05"; p { out $d "d"; }', b"00005\r"),
        ('p { out "a" # %d\n"%d" esc; }', b"a5\x1b\r"),
        ('p { out "\xb0%d"; }', b"\xb05\r"),
        ('p { out "\\_%d\\x20"; }', b" 5 \r"),
    ],
)
def test_texts_and_variables(text: str, wire: bytes) -> None:
    made = load_protocol_text(from_streamdevice(f"Terminator = CR;\n{text}", "x.proto", "made").text, "made.yaml")
    name = next(name for name in made.frames if name.lower().startswith("p_"))
    assert framekit.Protocol(made).encode(name, value=5) == wire


def test_variables_that_nothing_uses_are_told() -> None:
    text = 'Terminater = CR; Terminator = LF; x = 1; y = $x; p { z = 2; out "\\${z}"; w = 3; }'
    assert [message.partition(": warning: ")[2] for message in messages_of(text)] == [
        "nothing uses the variable 'terminater' – did you mean terminator?",
        "nothing uses the variable 'y' – use it, or remove it",
        "nothing uses the variable 'w' – use it, or remove it",
    ]


def test_marks_of_an_editor_are_no_part_of_a_name() -> None:
    text = b'\xef\xbb\xbfTerminator = CR; p { out "x"; }'.decode("latin-1")
    assert messages_of(text) == [] and "0D" in from_streamdevice(text, "x.proto", "made").text


@pytest.mark.parametrize(
    ("setting", "command", "what"),
    [
        ("MaxInput = 3", 'in "%3c"', ""),
        ("MaxInput = 2", 'in "%3c"', "MaxInput 2 ends it before its 3 bytes"),
        ("MaxInput = 4", 'in "%3c"', "only silence ends what is read"),
        ("MaxInput = 0", 'in "%3c"', "only silence ends what is read"),
        ("MaxInput = 9", 'in "%s"', "with nothing behind it that ends it"),
        ("Terminator = CR; MaxInput = 9", 'in "%s"', "MaxInput 9 beside a terminator"),
    ],
)
def test_the_greatest_input(setting: str, command: str, what: str) -> None:
    found = messages_of(f'Terminator = ""; {setting}; p {{ {command}; }}')
    assert len(found) == bool(what) and what in "".join(found)


@pytest.mark.parametrize("size", [10, 1000, 100_000])
def test_messages_stay_short_however_long_a_name_is(size: int) -> None:
    name = "n" * size
    commands = f"shout; out '%d'; out ${name}; out '\\${{{name}}}'; wait {name}; in '%{{{name}'; " * 3
    left_out = messages_of(f"{name} {{ {commands} }} {name}2 {{ {name}; @init {{ {name}; }} }} {name}3 {{ out 'x'; }}")
    wrong = messages_of(f"{name} {{ {{ = {name} }} }} {name} {{ }} a = $b{name}; @x{name} {{ }} {name} {name};")
    assert len(left_out) > 10 and len(wrong) > 5 and max(map(len, left_out + wrong)) < 400


def test_every_error_at_once() -> None:
    text = 'A = $nothing;\na { out "open;\n  shout "x"; }\nb { @later { } { out } }\nb { out "%q"; = 3 }\n}\n'
    assert [message.partition(" – ")[0] for message in messages_of(text)] == [
        "x.proto:1:5: there is no variable 'nothing'",
        "x.proto:2:9: the text '\"open;' has no end",
        "x.proto:4:5: there is no handler '@later'",
        "x.proto:4:16: a block has no name here",
        "x.proto:5:1: there are two protocols 'b'",
        "x.proto:5:15: '=' is no command",
        "x.proto:6:1: '}' is no protocol and no setting",
    ]
    assert messages_of("") == ["x.proto:1:1: no protocol is in this file – write NAME { … }"]
    assert messages_of("message X { int32 a = 1; }")[0].startswith(
        "x.proto:1:1: 'message' is no protocol and no setting"
    )


@pytest.mark.parametrize("text", ["p { " + "{" * 3000, "p{" * 3000, "p { out " + "${" * 3000])
def test_blocks_inside_each_other_have_a_bound(text: str) -> None:
    assert any(
        "blocks stand deeper inside each other than 20 – end each with }" in message for message in messages_of(text)
    )


def test_equal_names_get_numbers() -> None:
    text = 'Terminator = CR; p { out "a%(x)d,%(x)d,%(x_2)d,%(x)d,%(value)d,%d"; in "%(X.VAL)d"; } p_in { in "b"; }'
    text += 'read { out "c"; in "d"; } exchange { out "e%(station)d"; in "f"; } p! { out "g"; } p? { out "h"; }'
    made = load_protocol_text(from_streamdevice(text, "x.proto", "made").text, "made.yaml")
    assert sorted(made.services) == ["exchange_p", "p", "p_", "p__2", "p_in", "read_2"]
    assert len(made.frames) == len(set(made.frames)) == 9


DOUBLING = {
    "protocols": 'p0 { out "0"; } ' + "".join(f"p{n} {{ p{n - 1}; p{n - 1}; }} " for n in range(1, 40)),
    "commands": "p0 { event; } " + "".join(f"p{n} {{ p{n - 1}; p{n - 1}; }} " for n in range(1, 40)),
    "values": 'v0 = "0123456789"; '
    + "".join(f"v{n} = $v{n - 1} $v{n - 1}; " for n in range(1, 40))
    + "p { out $v39; }",
    "quoted": 'v0 = "0123456789"; ' + "".join(f'v{n} = "\\${{v{n - 1}}}\\${{v{n - 1}}}"; ' for n in range(1, 40)),
    "handlers": '@init { out "a"; out "b"; } ' + "".join(f"p{n} {{ out 'x'; }} " for n in range(8000)),
}


@pytest.mark.parametrize("shape", spread(DOUBLING, 3))
def test_what_takes_itself_over_and_over_has_a_bound(shape: str) -> None:
    (one,) = messages_of(f"Terminator = CR; {DOUBLING[shape]}")
    assert "all protocols together have more than" in one


GROWING: dict[str, Callable[[int], str]] = {
    "protocols": lambda n: "".join(f'p{k} {{ out "a{k}"; in "%d"; }} ' for k in range(n)),
    "commands": lambda n: "p { " + 'out "a"; in "%d"; ' * n + "}",
    "elements": lambda n: 'p { out "' + "%d," * n + '"; }',
    "equal names": lambda n: (
        "".join(f"p{'!' * (k + 1)} {{ out 'a{k}'; }} " for k in range(n))
        if n < 200
        else "p { in '" + "%(x)d," * n + "'; }"
    ),
    "redirected names": lambda n: "p { in '" + "".join(f"%(x_{k})d,%(x)d," for k in range(n)) + "'; }",
    "one long string": lambda n: f"p {{ out '{'ab' * 10 * n}'; }}",
    "escapes": lambda n: "p { out '" + "\\x02\\$1\\r" * n + "'; }",
    "variables": lambda n: (
        "".join(f"v{k} = 'x'; " for k in range(n)) + "".join(f"p{k} {{ out $v{k}; }} " for k in range(n))
    ),
    "variables in strings": lambda n: "v = 12; p { out '" + "\\${v}," * n + "'; }",
    "unknown commands": lambda n: "p { " + "shout; " * n + "}",
    "open brackets": lambda n: 'p { out "' + "%(" * n + '"; }',
    "open sets": lambda n: 'p { in "' + "%[" * n + '"; }',
    "check codes": lambda n: "p { out 'ab" + "%<sum>,%2<xor>" * n + "'; }",
    "words": lambda n: "p { in '%{" + "|".join(f"w{k}" for k in range(n)) + "}'; }",
    "quotes": lambda n: "p { out " + "'" * n + " }",
    "open texts": lambda n: "p { out " + "'\\'" * n,
    "open texts in lines": lambda n: "p { out " + "'a\\\n" * n,
    "signs": lambda n: "=;{" * n,
    "comments": lambda n: "# c\n" * n + "p { out 'x'; }",
    "numbers": lambda n: "p { out " + "1 -2 0x3 " * n + "; }",
    "digits": lambda n: f"p {{ wait {'1' * n}; out {'2' * n}; out '%{'3' * n}d'; }}",
    "requests alike": lambda n: "".join(f'p{k} {{ out "MEASURE:{k:05}?"; in "%d"; }} ' for k in range(n)),
    "settings": lambda n: "".join(f"p{k} {{ ReplyTimeout = {k + 10}; out 'a{k}'; in '%d'; }} " for k in range(n)),
}


def steps_of(text: str) -> int:
    """Return the number of executed Python lines for a file."""
    count = 0

    def trace(frame: object, event: str, argument: object) -> Callable[..., object]:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        messages_of(text)
    finally:
        sys.settrace(before)
    return count


@pytest.mark.parametrize("shape", spread(GROWING, 5))
def test_work_grows_as_the_file_does(shape: str) -> None:
    text = GROWING[shape]
    small, large = (steps_of(f"Terminator = CR LF;\n{text(size)}") for size in (250, 1000))
    assert large < 4.6 * small + 5000


# ---- any text ------------------------------------------------------------------------------------------------------

PIECES = [
    "%d", "%4d", "%04d", "%+d", "% d", "%-4d", "%u", "%i", "%f", "%.2f", "%8.3f", "%#.0f", "%e", "%E", "%g", "%s",
    "%5s", "%#s", "%c", "%3c", "%x", "%02X", "%o", "%[A-Z]", "%[^,]", "%{on|off}", "%{on|offline|0}", "%#{a=1|b=-2}",
    "%r", "%2r", "%.2r", "%#04r", "%4R", "%2D", "%0<xor>", "%<sum16>", "%1<crc16>", "%b", "%*d", "%(level)d",
    "%(station)f", "%(in)s", "A", " ", "=", ",", "OK", "\\x02", "\\r", "\\r\\n", "\\$1", "\\$2", "\\${v}", "%%", "\\?",
    "\\_",
    "'", "\xe9", "#", ": {", "- x",
]  # fmt: skip
strings = st.lists(st.sampled_from(PIECES), max_size=5).map(lambda found: f'"{"".join(found)}"')
texts = st.one_of(strings, strings, st.sampled_from(["STX 3", "$v", "ESC $v 0x41", "SKIP", "$1"]))
commands = st.one_of(
    st.tuples(st.sampled_from(["out", "in"]), texts).map(lambda found: f"{found[0]} {found[1]};"),
    st.sampled_from([
        "wait 100;", "out STX 3;", "in ETX;", "p0;", "@init { out 'x'; in '%d'; }", 'InTerminator = ";";', "event;",
        'Terminator = "";', "ExtraInput = Ignore;", "ReplyTimeout = 7;", "ReadTimeout = 0;", "v = 5 'b';",
        "MaxInput = 3;",
    ]),
)  # fmt: skip
protocols = st.lists(st.lists(commands, max_size=4), min_size=1, max_size=4)
endings = st.sampled_from(
    ["", "Terminator = CR;\n", "Terminator = CR LF;\nOutTerminator = NUL;\n", "Terminator = ', ';"]
)


@settings(max_examples=150)
@given(endings, protocols)
def test_every_definition_that_is_made_is_a_right_one(ending: str, found: list[list[str]]) -> None:
    text = f"v = 'v%d';{ending}" + "\n".join(f"p{number} {{ {' '.join(one)} }}" for number, one in enumerate(found))
    try:
        made = from_streamdevice(text, "x.proto", "made")
    except DefinitionError as error:
        assert error.problems and all(problem.at.file == "x.proto" and problem.todo for problem in error.problems)
        return
    assert all(problem.at.file == "x.proto" and problem.todo for problem in made.left_out)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "made.yaml"
        path.write_text(made.text, "utf-8")
        assert check_warnings(path) == []


@given(st.text())
def test_any_text_ends_in_words(text: str) -> None:
    assert messages_of(text) != []


SIGNS = "".join(map(chr, range(256)))


@pytest.mark.long
def test_damaged_files_end_in_words() -> None:
    rng, wrong, made = Random(1), 0, 0
    for _ in range(400):
        text = list(SUPPLY)
        for _ in range(rng.randrange(1, 6)):
            place = rng.randrange(len(text))
            text[place : place + rng.randrange(3)] = rng.choice([rng.choice(SIGNS), rng.choice("{}\"'%$\\;=#<[("), ""])
        try:
            made += bool(from_streamdevice("".join(text), "x.proto", "made").text)
        except DefinitionError as error:
            wrong += all(problem.todo for problem in error.problems)
    assert wrong + made == 400 and wrong > 50 and made > 50


# ---- the verb ------------------------------------------------------------------------------------------------------


def test_the_verb_writes_it_and_tells_what_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "My Supply.proto"
    file.write_bytes(SUPPLY.encode("latin-1") + b"late { event; }\nraw { out '\xb0\x81'; }\n")
    assert main(["import", str(file)]) == 0
    assert "the command event, which no definition has: protocol 'late' is left out" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "my-supply.yaml")]) == 0
    assert main(["import", str(file), "--strict", "-o", str(tmp_path / "supply.yaml")]) == 1
    made = framekit.load(tmp_path / "supply.yaml")
    assert made.encode("raw_out") == b"\xb0\x81\r\n"
    assert main(["import", str(file)]) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.mark.parametrize("way", ["itself", "symlink", "hard link", "another name of it"])
def test_the_file_that_is_read_is_not_written_over(
    way: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, place = tmp_path / "s.proto", tmp_path / "s.yaml"
    text = 'Terminator = CR; p { out "x"; }'
    if way == "itself":
        file = place
        file.write_text(text, "utf-8")
    else:
        file.write_text(text, "utf-8")
    if way == "symlink":
        place.symlink_to(file)
    elif way == "hard link":
        place.hardlink_to(file)
    elif way == "another name of it":
        (tmp_path / "folder").mkdir()
        place.symlink_to(file)
        place = tmp_path / "folder" / ".." / "s.yaml"
    assert main(["import", str(file), "-o", str(place)]) == 2
    says = "has no ending that says what it is" if way == "itself" else "is the file that is read"
    assert says in capsys.readouterr().err and file.read_text("utf-8") == text


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["x.txt"], 2, ".proto (a protocol file of EPICS StreamDevice)"),
        (["none.proto"], 2, "none.proto: No such file or directory"),
        (["long.proto"], 1, "long.proto:1:1: the file has more than 1000000 bytes – divide it"),
        (["x.proto", "-o", "X.yaml"], 2, "is no name of a protocol"),
        (
            ["1.proto"],
            2,
            "'1' is no name of a protocol – write small letters, digits, - and _, such as meter.yaml; name ",
        ),
        (["x.proto", "-o", "x.txt"], 2, "is no file of a definition"),
        (["x.proto", "-o", "none/x.yaml"], 1, "none/"),
        (["empty.proto"], 1, "empty.proto:1:1: no protocol is in this file"),
    ],
)
def test_what_the_verb_refuses(
    words: list[str], status: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    for name in ("x.proto", "x.txt", "1.proto"):
        Path(name).write_text("Terminator = CR; p { out 'x'; }", "utf-8")
    Path("long.proto").write_text("#" * 1_000_001, "utf-8")
    Path("empty.proto").touch()
    assert main(["import", *words]) == status
    assert message in capsys.readouterr().err and not list(tmp_path.glob("**/*.yaml"))
