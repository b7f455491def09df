"""Formats of StreamDevice, one by one, compared with StreamDevice's own behaviour.

`out` sends the output of C's printf; `in` is compared with a small model of StreamDevice's reading. An imported format
gives the same bytes and the same values, or a fault.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from decimal import Decimal
from itertools import product
from random import Random
from typing import Any

import pytest
import yaml
from spread import many, spread

from framekit.api.codec import Protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError
from framekit.extras.streamdevice.importing import from_streamdevice

WHOLE = [0, 1, -1, 7, 42, -42, 99, 255, 1000, 4095, 65535, -70000, 123456789]
REALS = [0.0, 1.0, -1.0, 0.5, 1.25, -3.75, 12.125, 100.5, 1234.5, -0.0625, 1e6, 65536.25, 2.5e-3, 1e15]
TEXTS = ["", "a", "abc", "abcdefgh", "x y", "A,B"]


def frames_of(commands: Sequence[str], settings: str = "Terminator = CR LF;") -> tuple[Protocol | None, dict[str, str]]:
    """Return a protocol of one command each, and the frames of the imported commands."""
    text = "\n".join([settings, *(f"p{number} {{ {command}; }}" for number, command in enumerate(commands))])
    try:
        made = from_streamdevice(text, "x.proto", "made")
    except DefinitionError as error:
        assert all(problem.todo for problem in error.problems)
        return None, {}
    frames = {}
    for name, sequence in yaml.safe_load(made.text)["sequences"].items():
        (step,) = sequence["steps"]
        sent = step["send"] if "send" in step else step["receive"][0]["frame"]
        frames[commands[int(name[1:])]] = sent if isinstance(sent, str) else next(iter(sent))
    return Protocol(load_protocol_text(made.text, "made.yaml")), frames


def frame_of(command: str, settings: str = "Terminator = CR LF;") -> tuple[Protocol, str] | None:
    protocol, frames = frames_of([command], settings)
    return None if protocol is None else (protocol, frames[command])


def flags_of(signs: str) -> Iterator[str]:
    yield ""
    yield from signs
    yield from (a + b for a in signs for b in signs if a < b)


def formats(kinds: str) -> Iterator[str]:
    widths = ["", "1", "2", "4", "5", "8"]
    for kind, flags, width, precision in product(kinds, flags_of("-+ 0#"), widths, ["", ".0", ".1", ".2", ".3"]):
        yield f"%{flags}{width}{precision}{kind}"


def as_printf(form: str, value: Any) -> bytes:
    """Return the output of C's printf: no + before unsigned numbers. StreamDevice cuts hex digits to their width."""
    match = re.fullmatch(r"%([-+ 0#]*)(\d*)(\.\d+)?(\w)", form)
    assert match is not None
    flags, width, precision, kind = match[1], match[2], match[3] or "", match[4]
    if kind in "xX" and width:
        value &= 16 ** int(width) - 1
    if kind in "xXou":
        value &= 2**64 - 1
        flags = flags.replace("+", "").replace(" ", "")
    if kind in "diouxX" and precision:
        flags = flags.replace("0", "")  # C ignores this flag if a precision is given
    return (f"%{flags}{width}{precision}{kind}" % value).encode("latin-1")


VALUES: dict[str, list[Any]] = {**dict.fromkeys("diuxXo", WHOLE), **dict.fromkeys("feEgG", REALS), "s": TEXTS}


@pytest.mark.parametrize("kind", spread(VALUES, 6))
def test_what_is_sent_is_what_printf_writes(kind: str) -> None:
    wanted = {f'out "A{form}{behind}"': (form, behind) for form in formats(kind) for behind in ("", "Z", " V")}
    protocol, frames = frames_of(list(wanted))
    sent = 0
    for command, frame in frames.items():
        form, behind = wanted[command]
        for value in VALUES[kind]:
            assert protocol is not None
            try:
                found = protocol.encode(frame, value=value)
            except EncodeError:
                continue
            assert found == b"A" + as_printf(form, value) + behind.encode() + b"\r\n", (form, value)
            again = protocol.decode(found, frame).fields["value"]
            assert again.rstrip() == value if kind == "s" else float(again) == value, (form, value)
            sent += 1
    assert (frames != {} and sent > len(frames)) == (kind not in "egG")


def scanned(form: str, line: bytes) -> tuple[Any, int] | None:
    """Return the value and the number of bytes that StreamDevice's documentation gives for a line.

    None for a mismatch.
    """
    match = re.fullmatch(rb"%([-+ 0#!]*)(\d*)([\w])", form.encode())
    assert match is not None
    flags, width, kind = match[1].decode(), int(match[2] or 0), match[3].decode()
    if kind == "c":
        data = line[: width or 1].partition(b"\0")[0]
        return data.decode("latin-1"), len(data)
    spaces = len(line) - len(line.lstrip(b" \t\n\v\f\r"))
    if kind == "s":
        kept = " " in flags
        place = min(spaces, width) if kept and width else spaces
        room = (width - place if kept else width) if width else len(line)
        rest = line[place : place + room]
        data = rest.partition(b"\0")[0] if "#" in flags else re.match(rb"[^ \t\n\v\f\r\0]*", rest)[0]  # type: ignore[index]
        return (line[:place] * kept + data).decode("latin-1"), place + len(data)
    room = (width - spaces if " " in flags else width) if width else len(line)
    text = line[spaces : spaces + max(room, 0)]
    sign = re.match(rb"[+-]?", text)[0]  # type: ignore[index]
    digits = text[len(sign) :]
    if sign == b"-" and (kind == "u" or (kind in "oxX" and "-" not in flags)):
        return None
    pattern = {
        "d": rb"\d+", "u": rb"\d+", "o": rb"[0-7]+", "x": rb"(?:0[xX](?=[0-9a-fA-F]))?[0-9a-fA-F]+",
        "i": rb"0[xX][0-9a-fA-F]+|0[0-7]*|[1-9]\d*",
    }.get(kind.lower() if kind == "X" else kind, rb"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")  # fmt: skip
    found = re.match(pattern, digits)
    if found is None:
        return None
    shown = found[0].decode()
    if kind in "feEgG":
        value: Any = Decimal(shown)
    elif kind == "i":
        value = int(shown, 16 if shown[:2].lower() == "0x" else 8 if shown[0] == "0" else 10)
    else:
        value = int(shown, {"o": 8, "x": 16, "X": 16}.get(kind, 10))
    return (-value if sign == b"-" else value), spaces + len(sign) + len(shown)


LINES = [
    "0", "1", "7", "12", "-12", "+12", "0012", " 12", "12 ", "  7", "1.5", "-0.5", "+1.5", "1.50", "1e3", "1.5E+02",
    ".5", "5.", "0x1F", "1F", "ff", "077", "09", "-", "", " ", "abc", "a b", "abcde", "abcdefgh", " abc", "123456",
    "12345678", "12.345", "-1", "1-2", "1,2", "OK", "1Z", "12Z", "5 V", "abZ", "Zab", "12\r", "a\tb", "inf", "nan",
    "0x", "\xb0C",
]  # fmt: skip


@pytest.mark.parametrize("kind", spread("diuxXofeEgGsc", 4))
def test_what_is_taken_has_the_value_that_stream_device_reads(kind: str) -> None:
    rng, read = Random(1), 0
    every = [*product(flags_of("-+ 0#!"), ["", "1", "2", "3", "5", "8"], ["", "Z", " V", ",", "-"])]
    forms = (
        (f"%{flags}{width}{kind}", behind) for flags, width, behind in rng.sample(every, len(every) // many(16, 1))
    )
    wanted = {f'in "{form}{behind}"': (form, behind) for form, behind in forms}
    protocol, frames = frames_of(list(wanted))
    for command, frame in frames.items():
        form, behind = wanted[command]
        assert protocol is not None
        for line in [*LINES, *("".join(rng.choices("0129.-+eEfx abZ,", k=rng.randrange(1, 9))) for _ in range(40))]:
            data = (line + behind).encode("latin-1")
            try:
                value = protocol.decode(data + b"\r\n", frame).fields["value"]
            except FrameError:
                continue
            taken = scanned(form, data)
            assert taken is not None and data[taken[1] :] == behind.encode(), (form, data, value)
            assert value == taken[0], (form, data)
            read += 1
    assert len(frames) > 5 and read > 20


@pytest.mark.parametrize("behind", ["", ",", "1", "x"])
@pytest.mark.parametrize("members", ["A-Z", "^,", "^,;", "0-9.", "a-cx-z_", "^a-z", "]a", "^]", "-a", "a-", "^ \\t"])
def test_sets_take_what_regular_expressions_do(members: str, behind: str) -> None:
    rng = Random(2)
    found = frame_of(f'in "%[{members}]{behind}"')
    pattern = members.replace("]", "\\]")
    pattern = f"\\{pattern}" if pattern.startswith("-") else pattern
    wanted = re.compile(f"([{pattern}]*){re.escape(behind)}", re.S)
    for _ in range(200 if found else 0):
        assert found is not None
        line = "".join(rng.choices("abcxyzABC019.,;_- \t]x", k=rng.randrange(6)))
        try:
            value = found[0].decode(f"{line}{behind}\r\n".encode(), found[1]).fields["value"]
        except FrameError:
            continue
        match = wanted.fullmatch(line + behind)
        assert match is not None and match[1] == value, (members, line)
    first = re.compile(f"[{pattern}]")
    assert (found is None) == bool(behind and first.match(behind))


@pytest.mark.parametrize(
    ("words", "pairs"),
    [
        ("OFF|ON", {0: "OFF", 1: "ON"}),
        ("A|B|C", {0: "A", 1: "B", 2: "C"}),
        ("1|0", {0: "1", 1: "0"}),
        ("it\\'s|{x|\\|", {0: "it's", 1: "{x", 2: "|"}),
        ("on|", {0: "on", 1: ""}),
        ("#neg=-1|stop|pos|fast=10|rewind=-10", {-1: "neg", 0: "stop", 1: "pos", 10: "fast", -10: "rewind"}),
    ],
)
def test_enumerations(words: str, pairs: dict[int, str]) -> None:
    form = f"%{'#' * words.startswith('#')}{{{words.removeprefix('#')}}}"
    for command in (f'out "S {form}"', f'in "S {form}"'):
        found = frame_of(command)
        assert found is not None
        protocol, name = found
        for number, word in pairs.items():
            wire = f"S {word}\r\n".encode()
            assert protocol.encode(name, value=number) == wire
            assert protocol.decode(wire, name).fields["value"] == number
        for wrong in (5, -2, 77):
            with pytest.raises(EncodeError):
                protocol.encode(name, value=wrong)
        with pytest.raises(FrameError):
            protocol.decode(b"S none\r\n", name)


def test_words_that_are_never_found_are_told() -> None:
    with pytest.raises(DefinitionError, match="'ABC' begins with a word before it"):
        from_streamdevice('Terminator = CR; p { in "%{AB|ABC}"; }', "x.proto", "made")


def raw(value: int, size: int, order: str) -> bytes:
    return value.to_bytes(size, order, signed=value < 0)  # type: ignore[arg-type]


@pytest.mark.parametrize("little", ["", "#"])
@pytest.mark.parametrize("unsigned", ["", "0"])
@pytest.mark.parametrize("size", range(1, 9))
def test_raw_numbers(size: int, unsigned: str, little: str) -> None:
    order = "little" if little else "big"
    limits = (0, 256**size - 1) if unsigned else (-(256**size) // 2, 256**size // 2 - 1)
    for command in (f"out 'A%{little}{unsigned}.{size}r'", f"in 'A%{little}{unsigned}{size}r'"):
        found = frame_of(command, "")
        assert found is not None
        protocol, name = found
        for value in {*limits, 0, 1, 100, limits[0] // 2, limits[1] // 3}:
            wire = b"A" + value.to_bytes(size, order, signed=not unsigned)
            assert protocol.encode(name, value=value) == wire
            assert protocol.decode(wire, name).fields == {"value": value}


def test_width_of_a_raw_number_that_is_sent_is_no_size() -> None:
    """A sent %2r writes one byte of the number and its sign in another byte."""
    assert frame_of("out '%2r'") is None and frame_of("out '%r'") is not None and frame_of("out '%1r'") is not None


@pytest.mark.parametrize(("form", "code"), [("R", ">f"), ("4R", ">f"), ("8R", ">d"), ("#8R", "<d"), ("#R", "<f")])
def test_raw_floats(form: str, code: str) -> None:
    found = frame_of(f"in 'A%{form}'", "")
    assert found is not None
    protocol, name = found
    assert protocol.encode(name, value=-2.5) == b"A" + struct.pack(code, -2.5)


@pytest.mark.parametrize(("form", "value", "wire"), [("2D", 1234, "12 34"), ("#2D", 1234, "34 12"), ("D", 7, "07")])
def test_packed_digits(form: str, value: int, wire: str) -> None:
    found = frame_of(f"in 'A%{form}'", "")
    assert found is not None
    protocol, name = found
    assert protocol.decode(b"A" + bytes.fromhex(wire), name).fields == {"value": value}


NINE = b"123456789"
CODES = {
    "sum": 0xDD, "sum8": 0xDD, "sum16": 0x01DD, "sum32": 0x1DD, "nsum8": 0x23, "nsum16": 0xFE23, "nsum32": 0xFFFFFE23,
    "-sum": 0x23, "negsum": 0x23, "nsum": 0x23, "-sum16": 0xFE23, "notsum": 0x22, "~sum": 0x22, "xor": 0x31,
    "xor8": 0x31, "xor8ff": 0xCE, "xor7": 0x31, "crc8": 0xF4, "ccitt8": 0xA1, "crc16": 0xFEE8, "crc16r": 0xBB3D,
    "modbus": 0x4B37, "ccitt16": 0x29B1, "ccitt16a": 0xE5CC, "ccitt16x": 0x31C3, "crc16c": 0x31C3, "xmodem": 0x31C3,
    "crc32": 0xFC891918, "crc32r": 0xCBF43926, "jamcrc": 0x340BC6D9, "lrc": 0x23, "CRC16": 0xFEE8, "Sum": 0xDD,
}  # fmt: skip
"""The check codes of 123456789 by StreamDevice's names."""
SIZES = {"16": 2, "32": 4, "mod": 2, "xmo": 2, "jam": 4}


@pytest.mark.long
def test_check_codes_have_the_values_that_stream_device_names() -> None:
    for name, value in CODES.items():
        size = next((size for part, size in SIZES.items() if part in name.lower()), 1)
        big, little = raw(value, size, "big"), raw(value, size, "little")
        nibbles = bytes(0x30 | nibble for byte in big for nibble in (byte >> 4, byte & 15))
        wanted = {
            "": big, "#": little, "0": big.hex().upper().encode(), "#0": little.hex().upper().encode(),
            "-": nibbles, "+": str(value).zfill({1: 3, 2: 5, 4: 10}[size]).encode(),
        }  # fmt: skip
        for flags, code in wanted.items():
            for start in ("", "2"):
                covered = "ab" * bool(start)
                found = frame_of(f'out "{covered}123456789%{flags}{start}<{name}>"')
                assert found is not None
                assert found[0].encode(found[1]) == covered.encode() + NINE + code + b"\r\n", (name, flags)


@pytest.mark.parametrize(
    "name", ["adler32", "hexsum", "cpi", "leybold", "brksC", "hexlrc", "bitsum", "hv_mps", "negcrc16"]
)
def test_other_check_codes_are_told(name: str) -> None:
    with pytest.raises(DefinitionError, match="no check code is like it"):
        from_streamdevice(f'p {{ out "a%<{name}>"; }}', "x.proto", "made")


TOLD: list[tuple[str, str]] = [
    ('out "%-5d"', "spaces stand behind the number"),
    ('out "%4x"', "spaces stand in place of zeros"),
    ('out "%x"', "as many digits as it needs"),
    ('out "%#06x"', "0x or 0 stands before the digits"),
    ('out "%5s"', "fill stands before the text"),
    ('out "%5.2s"', "the text is cut"),
    ('out "%e"', "writes a small e"),
    ('out "%.3g"', "chooses how it is written"),
    ('out "%5c"', "one character by its number"),
    ('out "%[a-z]"', "only in has it"),
    ('out "%*d"', "are for in"),
    ('out "%d%d"', "nothing behind it that ends it"),
    ('out "%d-%d"', "which could belong to it"),
    ('out "%f.1"', "which could belong to it"),
    ('out "%fE"', "which could belong to it"),
    ('out "%2.1<xor>"', "it covers other bytes"),
    ('out "a%<rot13>"', "no such check code"),
    ('in "%.3f"', "in takes no precision"),
    ('in "%?d"', "takes what does not fit as 0"),
    ('in "%=d"', "compares with a value"),
    ('in "%s,%s"', "goes on to a space"),
    ('in "%[^;],"', "goes on over ','"),
    ('in "%/x+/"', "no segment is like it"),
    ('in "%T(%Y)"', "no segment is like it"),
    ('in "%b"', "no segment is like it"),
    ('in "%B.!"', "no segment is like it"),
    ('in "%m"', "no segment is like it"),
    ('in "%y"', "no converter of StreamDevice's own"),
    ('in "%"', "nothing behind it"),
    ('in "%[a"', "has no end"),
    ('in "%(a"', "has no end"),
    ('in "%{a"', "has no end"),
    ('in "\\_%d"', "takes any space"),
    ('in "a\\r\\nb"', "so it never comes"),
    ('in "%0$1d"', "nothing behind it|no converter|outside"),
    ('out "\\?"', "any byte cannot be sent"),
    ("out $1", "outside of quotes"),
    ("out 256", "is no byte"),
    ("out -129", "is no byte"),
    ("out something", "is no byte"),
    ('out "\\999"', "is no byte"),
    ('out "\\xg"', "no hex digits"),
    ('out "\\$0"', "the name of the protocol"),
    ('out "\\$f"', "there is no variable 'f'"),
    ("out $f", "there is no variable 'f'"),
    ("wait x", "is no number"),
    ('event(1) 100', "the command event"),
    ('exec "ls"', "the command exec"),
    ("connect 100", "the command connect"),
    ("disconnect", "the command disconnect"),
    ("shout 'x'", "no command or protocol 'shout'"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "what"), TOLD)
def test_what_cannot_be_carried_out_is_told_with_its_place(command: str, what: str) -> None:
    with pytest.raises(DefinitionError, match=what) as raised:
        from_streamdevice(f"Terminator = CR LF;\np {{ {command}; }}\n", "x.proto", "made")
    assert all(problem.at.line == 2 and problem.at.column > 1 and problem.todo for problem in raised.value.problems)


@pytest.mark.parametrize("word", spread(["in", "out"], 2))
def test_every_flag_of_every_converter_is_carried_out_or_told(word: str) -> None:
    """No combination raises another error, and all remaining commands give a definition that loads."""
    every = product(
        ["b", "B01", "c", "r", "R", "D", "m", "[a]", "{a|b}", "<sum>", "/a/", "T(%Y)"],
        ["", "*", "+", "-", " ", "0", "#", "?", "=", "!", "*0", "+0"], ["", "0", "3", "9", "999999"],
        ["", ".0", ".2", ".99999"],
    )  # fmt: skip
    commands = [f'{word} "A%{flags}{width}{precision}{kind}Z"' for kind, flags, width, precision in every]
    protocol, frames = frames_of(commands)
    assert protocol is not None and 100 < len(frames) < len(commands)
