"""A protocol file of EPICS StreamDevice as a definition: frames, a service for each protocol, and what was left out.

StreamDevice describes lines of text: what goes out (`out "CURR %.3f";`), and what comes in (`in "CURR %f";`). A
protocol of one `out` and one `in` becomes a request and its reply, with a simulated device; longer ones become
sequences of the client. Words of the file get into the definition as quoted text, hex bytes, or names made of letters,
digits and `_`. Source: StreamDevice 2, Protocol Files and Format Converters.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from framekit.definition.imported import ImportedDefinition
from framekit.definition.problems import DefinitionError, Position, Problem

MOST_SIGNS = 1_000_000
"""A longer file is refused."""
MOST_ELEMENTS = 10_000
"""So many pieces may all protocols have together, with those that they take from each other."""


def from_streamdevice(text: str, file: str, name: str) -> ImportedDefinition:
    """The definition of a protocol file. `name`: of the protocol. Raises DefinitionError for what is no such file."""
    reader = _ProtoReader(text, file)
    reader.read()
    if reader.errors:
        raise DefinitionError(reader.errors)
    return _ProtoWriter(reader, name, file).write()


# ---- the file ---------------------------------------------------------------------------------------------------

_TOKEN = re.compile(
    r"""(?P<blank>\s+|\#[^\n]*)|(?P<string>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|(?P<sign>[{};=,])"""
    r"""|(?P<word>[^\s{};=,"'#]+)|(?P<wrong>.)""",
)
_CONVERTER = re.compile(
    r"%(?:\((?P<redirect>[^)]*)\))?(?P<flags>[*# +0?=!-]*)(?P<width>\d*)(?:\.(?P<precision>\d+))?"
    r"(?:(?P<letter>[diuoxXcsfeEgGbBrRDTm])|\[(?P<set>[^\]]+)\]|\{(?P<words>[^}]*)\}|<(?P<check>[^>]+)>"
    r"|/(?P<regex>[^/]*)/)"
)
_ESCAPES = {"a": 7, "b": 8, "t": 9, "n": 10, "r": 13, "e": 27, "0": 0}
_NAMES = [
    "nul", "soh", "stx", "etx", "eot", "enq", "ack", "bel", "bs", "ht", "lf", "vt", "ff", "cr", "so", "si",
    "dle", "dc1", "dc2", "dc3", "dc4", "nak", "syn", "etb", "can", "em", "sub", "esc", "fs", "gs", "rs", "us",
]  # fmt: skip
_BYTES = {**{name: value for value, name in enumerate(_NAMES)}, "tab": 9, "nl": 10, "del": 127}
_COMMANDS = ("out", "in", "wait", "event", "exec", "connect", "disconnect")
_SETTINGS = (
    "terminator", "interminator", "outterminator", "separator", "replytimeout", "readtimeout", "writetimeout",
    "locktimeout", "pollperiod", "maxinput", "extrainput",
)  # fmt: skip


class _Token(NamedTuple):
    kind: str
    text: str
    at: Position


class Literal(NamedTuple):
    """Bytes as they stand."""

    data: bytes


class Converter(NamedTuple):
    """A value in the text: `kind` is its letter, or set, words, check, argument, skip."""

    kind: str
    at: Position
    flags: str = ""
    width: int = 0
    precision: int | None = None
    about: str = ""
    redirect: str = ""


Element = Literal | Converter


@dataclass(slots=True)
class _Command:
    """`is_taken`: it is another protocol's, with the terminator of that one."""

    word: str
    at: Position
    elements: list[Element]
    terminator: bytes = b""
    is_taken: bool = False


@dataclass(slots=True)
class _Protocol:
    name: str
    at: Position
    commands: list[_Command] = field(default_factory=list)
    settings: dict[str, list[Element]] = field(default_factory=dict)


class _ProtoReader:
    """Reads all protocols of a file; goes on after an error."""

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.errors: list[Problem] = []
        self.left_out: list[Problem] = []
        self.protocols: dict[str, _Protocol] = {}
        self.settings: dict[str, list[Element]] = {}
        if len(text) > MOST_SIGNS:
            self.errors.append(Problem(Position(file, 1, 1), f"the file has more than {MOST_SIGNS} signs", "divide it"))
            text = ""
        self._tokens = list(self._cut(text))
        self._place = 0
        self._pieces = 0

    def _cut(self, text: str) -> Iterator[_Token]:
        line, begin = 1, 0
        for match in _TOKEN.finditer(text):
            at = Position(self.file, line, match.start() - begin + 1)
            if match.lastgroup == "wrong":
                self.errors.append(Problem(at, f"{match[0]!r} begins nothing", "close the string, or remove it"))
            elif match.lastgroup != "blank":
                yield _Token(str(match.lastgroup), match[0], at)
            if (lines := match[0].count("\n")) > 0:
                line, begin = line + lines, match.start() + match[0].rindex("\n") + 1
        yield _Token("end", "", Position(self.file, line, len(text) - begin + 1))

    # ---- statements ---------------------------------------------------------------------------------------

    def _next(self) -> _Token:
        token = self._tokens[self._place]
        if token.kind != "end":
            self._place += 1
        return token

    def _peek(self) -> _Token:
        return self._tokens[self._place]

    def _note(self, at: Position, what: str, todo: str) -> None:
        self.left_out.append(Problem(at, what, todo))

    def _wrong(self, at: Position, what: str, todo: str) -> None:
        """An error; what stands until the end of the statement is passed over."""
        self.errors.append(Problem(at, what, todo))
        while self._peek().kind != "end" and self._peek().text not in (";", "}", "{"):
            self._next()
        if self._peek().text == ";":
            self._next()

    def read(self) -> None:
        while (token := self._next()).kind != "end":
            if token.kind == "word" and self._peek().text == "=":
                self._setting(token, self.settings)
            elif token.kind == "word" and self._peek().text == "{":
                self._next()
                self._protocol(token)
            elif token.text != ";":
                self._wrong(token.at, f"{token.text!r} is no protocol and no setting", "write NAME { … } or NAME = …;")
        if not self.protocols and not self.errors:
            self.errors.append(Problem(Position(self.file, 1, 1), "no protocol is in this file", "write NAME { … }"))

    def _protocol(self, name: _Token) -> None:
        protocol = _Protocol(name.text, name.at, settings=dict(self.settings))
        if name.text in self.protocols:
            self.errors.append(Problem(name.at, f"there are two protocols {name.text!r}", "give one another name"))
        while (token := self._next()).text != "}":
            if token.kind == "end":
                self.errors.append(Problem(name.at, f"protocol {name.text!r} has no end", "write }"))
                return
            if token.kind == "word":
                self._statement(token, protocol)
            elif token.text != ";":
                self._wrong(token.at, f"{token.text!r} is no command", f"known: {', '.join(_COMMANDS)}")
        for command in protocol.commands:
            if command.is_taken:
                continue
            way = "outterminator" if command.word == "out" else "interminator"
            chosen = protocol.settings.get(way, protocol.settings.get("terminator", []))
            command.terminator = b"".join(one.data for one in chosen if isinstance(one, Literal))
        self.protocols[name.text] = protocol

    def _statement(self, token: _Token, protocol: _Protocol) -> None:
        word = token.text.lower()
        if self._peek().text == "=":
            self._setting(token, protocol.settings)
        elif token.text.startswith("@"):
            self._handler(token)
        elif word in _COMMANDS:
            elements = self._values()
            if word in ("out", "in", "wait"):
                protocol.commands.append(_Command(word, token.at, elements))
            else:
                self._note(token.at, f"the command {word} of {protocol.name!r}", "nothing in a definition is like it")
        elif token.text in self.protocols and self._peek().text == ";":
            self._next()
            protocol.commands += [replace(one, is_taken=True) for one in self.protocols[token.text].commands]
            self._count(token.at, sum(1 + len(one.elements) for one in protocol.commands))
        else:
            self._wrong(token.at, f"there is no command or protocol {token.text!r} before", "correct its name")

    def _handler(self, token: _Token) -> None:
        """What is done when something goes wrong, or at the start."""
        self._note(token.at, f"the handler {token.text}", "a frame of its own and a row in services may say it")
        if self._peek().text != "{":
            self._wrong(token.at, f"{token.text!r} has no commands", "write { … } behind it")
            return
        depth = 0
        while (inside := self._next()).kind != "end":
            depth += (inside.text == "{") - (inside.text == "}")
            if not depth:
                return
        self.errors.append(Problem(token.at, f"{token.text!r} has no end", "write }"))

    def _setting(self, token: _Token, into: dict[str, list[Element]]) -> None:
        self._next()  # =
        word, values = token.text.lower(), self._values()
        if word not in _SETTINGS:
            self.errors.append(Problem(token.at, f"there is no setting {token.text!r}", "correct its name"))
            return
        into[word] = values
        if word in ("separator", "maxinput", "extrainput", "readtimeout", "writetimeout", "locktimeout", "pollperiod"):
            self._note(token.at, f"the setting {token.text}", "see what the device needs")

    def _values(self) -> list[Element]:
        """What stands until the next semicolon."""
        found: list[Element] = []
        while (token := self._peek()).text not in (";", "}") and token.kind != "end":
            self._next()
            if token.kind == "string":
                found += self._string(token)
            elif token.kind == "word":
                found.append(self._word(token))
            elif token.text != ",":
                self.errors.append(Problem(token.at, f"{token.text!r} has no place here", "end the command with ;"))
        if self._peek().text == ";":
            self._next()
        else:
            self.errors.append(Problem(self._peek().at, "a command has no end", "write ;"))
        self._count(self._peek().at, 1 + len(found))
        return found

    def _count(self, at: Position, more: int) -> None:
        self._pieces += more
        if self._pieces > MOST_ELEMENTS:
            raise DefinitionError(
                [Problem(at, f"the protocols have more than {MOST_ELEMENTS} pieces", "divide the file")]
            )

    def _word(self, token: _Token) -> Element:
        text = token.text.lower()
        if text in _BYTES:
            return Literal(bytes([_BYTES[text]]))
        if re.fullmatch(r"\\?\$\d", text):
            return Converter("argument", token.at, about=text[-1])
        if text in ("skip", "?"):
            return Converter("skip", token.at)
        try:
            number = int(text, 16) if text.startswith(("0x", "-0x")) else int(text)
        except ValueError:
            number = 256
        if not -128 <= number <= 255:
            if re.fullmatch(r"\d+", text):  # the milliseconds of a time
                return Converter("number", token.at, width=min(int(text[:9]), 10**9))
            self.errors.append(Problem(token.at, f"{token.text!r} is no byte", "write a string, a name or a number"))
            return Literal(b"")
        return Literal(bytes([number & 0xFF]))

    def _string(self, token: _Token) -> list[Element]:
        text, found, place, data = token.text[1:-1], list[Element](), 0, bytearray()

        def end_literal() -> None:
            if data:
                found.append(Literal(bytes(data)))
                data.clear()

        while place < len(text):
            at = Position(token.at.file, token.at.line, token.at.column + place + 1)
            sign = text[place]
            if sign == "\\":
                more = re.match(r"x([0-9A-Fa-f]{1,2})|0([0-7]{1,3})|([1-9]\d{0,2})|\$(\d)|(.)", text[place + 1 :])
                assert more is not None  # the string ends with no lone \
                place += 1 + more.end()
                if more[4]:
                    end_literal()
                    found.append(Converter("argument", at, about=more[4]))
                elif more[5] == "?":
                    end_literal()
                    found.append(Converter("skip", at))
                else:
                    codes = ((more[1], 16), (more[2], 8), (more[3], 10))
                    number = next((int(code, base) for code, base in codes if code), None)
                    data.append((_ESCAPES.get(more[5], ord(more[5]) & 0xFF) if number is None else number) & 0xFF)
            elif sign == "%" and text[place : place + 2] == "%%":
                data.append(0x25)
                place += 2
            elif sign == "%":
                match = _CONVERTER.match(text, place)
                if match is None:
                    self.errors.append(Problem(at, "a converter that is not known", "write %% for a percent sign"))
                    return found
                end_literal()
                found.append(_converter(match, at))
                place = match.end()
            else:
                data += sign.encode("latin-1", "replace")
                place += 1
        end_literal()
        return found


def _converter(match: re.Match[str], at: Position) -> Converter:
    kinds = ("letter", "set", "words", "check", "regex")
    kind = next(one for one in kinds if match[one] is not None)
    precision = None if match["precision"] is None else int(match["precision"][:4])
    return Converter(
        match["letter"] if kind == "letter" else kind, at, match["flags"], int(match["width"][:4] or 0), precision,
        match[kind], match["redirect"] or "",
    )  # fmt: skip


# ---- the definition ---------------------------------------------------------------------------------------------


class _CannotSayError(Exception):
    """A converter that the language has nothing like."""


class _Frame(NamedTuple):
    """Lines of a body, and its values by name: whether each is a whole number, a decimal or a text."""

    body: list[str]
    values: dict[str, str]


class _ProtoWriter:
    """Writes the definition of what a reader has read."""

    def __init__(self, reader: _ProtoReader, name: str, file: str) -> None:
        self._reader = reader
        self._name = name
        self._file = file
        self.left_out = reader.left_out
        self.frames: dict[tuple[str, tuple[str, ...]], str] = {}
        self._requests: set[str] = set()
        self.services: list[str] = []
        self.sequences: dict[str, list[str]] = {}

    def write(self) -> ImportedDefinition:
        for protocol, name in zip(self._reader.protocols.values(), self._names(), strict=True):
            self._protocol(protocol, name)
        if not self.frames:
            raise DefinitionError(
                self.left_out or [Problem(Position(self._file, 1, 1), "nothing is sent", "write out")]
            )
        exchanges = ", ".join(["exchange", *self.sequences])
        lines = [
            "# Made of a protocol file of StreamDevice. Speed and format of the line are not in it: add them to line.",
            f"protocol: {self._name}",
            "extends: standard",
            "station: {type: none}",
            "params:",
            f"  reply_timeout: {{default: {self._timeout()} ms}}",
            "  retries: {default: 0}",
            "groups:",
            "  request: {from: client}",
            "frames:",
            *self._frames_in_order(),
            *(["services:", *self.services] if self.services else []),
            *(["sequences:", *(line for lines in self.sequences.values() for line in lines)] if self.sequences else []),
            "roles:",
            f"  client: {{lanes: {{main: {{exchange: [{exchanges}]}}}}}}",
            "  server: {lanes: {main: {listen: answer}}}",
        ]
        return ImportedDefinition("\n".join(lines) + "\n", tuple(sorted(set(self.left_out))))

    def _frames_in_order(self) -> Iterator[str]:
        """The frames, each once. Those with more constant bytes come first: a text alone fits nearly everything."""

        def order(frame: tuple[tuple[str, tuple[str, ...]], str]) -> tuple[int, int]:
            (_, body), _ = frame
            constants = sum(len(one) for one in body if one.startswith(("{text", "{const")))
            return sum("ascii" in one for one in body), -constants

        for (way, body), name in sorted(self.frames.items(), key=order):
            side = "from: server" if way == "in" else "group: request" if name in self._requests else "from: client"
            yield from (f"  {name}:", f"    {side}", "    body:", *(f"      - {one}" for one in body))

    def _timeout(self) -> int:
        """The time limit of replies in ms, which a definition has once: the longest of all."""
        every = [self._reader.settings, *(one.settings for one in self._reader.protocols.values())]
        given = [_number(one["replytimeout"]) for one in every if "replytimeout" in one]
        return min(max([time for time in given if time] or [1000], default=1000), 60_000)

    def _names(self) -> list[str]:
        """A name for each protocol, of letters, digits and _, no two alike and none of those of `standard`."""
        found: list[str] = []
        for given in self._reader.protocols:
            name = re.sub(r"[^A-Za-z0-9_]", "_", given)
            name = name if re.match(r"[A-Za-z]", name) else f"p_{name}"
            name = f"{name}_" if name in ("exchange", "answer", "request", "reply", "read", "write") else name
            while name in found:
                name += "_"
            found.append(name)
        return found

    def _protocol(self, protocol: _Protocol, name: str) -> None:
        made: list[tuple[_Command, str, _Frame]] = []
        for command in protocol.commands:
            if command.word == "wait":
                made.append((command, "", _Frame([], {})))
                continue
            number = sum(one.word == command.word for one, _, _ in made) + 1
            frame_name = f"{name}_{command.word}" + (f"_{number}" if number > 1 else "")
            try:
                frame = self._frame(command)
            except _CannotSayError:
                return  # it is told; a part of a protocol would be another protocol
            made.append((command, frame_name, frame))
        words = [command.word for command, _, _ in made]
        if not words:
            self.left_out.append(
                Problem(protocol.at, f"protocol {protocol.name!r} sends and takes nothing", "leave it")
            )
            return
        is_pair = words == ["out", "in"]
        made = [
            (command, self.frames.setdefault((command.word, tuple(frame.body)), named) if named else "", frame)
            for command, named, frame in made
        ]
        if is_pair:
            self._requests.add(made[0][1])
        if words == ["in"]:
            self.left_out.append(Problem(protocol.at, f"{protocol.name!r} only listens", "RECEIVE its frame in a run"))
        elif is_pair:
            self._pair(name, made)
        else:
            self._steps(name, made)

    def _pair(self, name: str, made: Sequence[tuple[_Command, str, _Frame]]) -> None:
        (_, asked_name, asked), (_, told_name, told) = made
        takes = _takes(asked.values)
        gives = ", ".join(f"{one}: reply.{one}" for one in told.values)
        answers = ", ".join(f"{one}: {_START[kind]}" for one, kind in told.values.items())
        self.services += [
            f"  {name}:",
            f"    - request: {{{asked_name}: {{{', '.join(f'{one}: {one}' for one in asked.values)}}}}}",
            f"      reply: {{{told_name}: {{{answers}}}}}  # what a simulated device answers",
            *([f"      takes: {{{takes}}}"] if takes else []),
            *([f"      gives: {{{gives}}}"] if gives else []),
        ]

    def _steps(self, name: str, made: Sequence[tuple[_Command, str, _Frame]]) -> None:
        """A sequence of the client: what goes out, each with what comes in after it."""
        takes: dict[str, str] = {}
        gives: dict[str, str] = {}
        shown: dict[str, str] = {}
        replies: list[str] = []
        steps: list[list[str]] = []
        for command, frame_name, frame in made:
            if command.word == "wait":
                steps.append([f"wait: {_number(command.elements)} ms"])
            elif command.word == "out":
                named = {one: self._unused(one, takes, kind) for one, kind in frame.values.items()}
                values = ", ".join(f"{one}: {given}" for one, given in named.items())
                steps.append([f"send: {{{frame_name}: {{{values}}}}}"])
            else:
                if not steps or any(key.startswith(("receive", "wait")) for key in steps[-1]):
                    steps.append([])
                kept = ""
                if frame.values:
                    reply = f"got_{len(replies) + 1}"
                    replies.append(reply)
                    gives |= {self._unused(one, shown, "", takes): f"{reply}.{one}" for one in frame.values}
                    kept = f", set: {{{reply}: it}}"
                steps[-1] += [
                    f"receive: [{{frame: {frame_name}{kept}, then: next}}]", "within: reply_timeout",
                    "on_timeout: {fail: no_reply}", "on_bad: {fail: damaged_reply}",
                ]  # fmt: skip
        self.services += [f"  {name}:", f"    - run: {name}", "      client_only: yes"]
        if takes:
            self.services.append(f"      takes: {{{_takes(takes)}}}")
        if gives:
            self.services.append(f"      gives: {{{', '.join(f'{one}: {one}' for one in gives)}}}")
        lines = [f"  {name}:"]
        if takes:
            lines.append(f"    takes: [{', '.join(takes)}]")
        if gives:
            lines.append(f"    gives: {{{', '.join(f'{one}: {value}' for one, value in gives.items())}}}")
            lines.append(f"    local: {{{', '.join(f'{one}: frame' for one in replies)}}}")
        lines.append("    steps:")
        for number, keys in enumerate(steps, 1):
            lines += [f"      - step: step_{number}", *(f"        {key}" for key in keys)]
        self.sequences[name] = lines

    @staticmethod
    def _unused(name: str, into: dict[str, str], kind: str, beside: dict[str, str] | None = None) -> str:
        """The name of a value among those of other frames."""
        unused, number = name, 2
        while unused in into or unused in (beside or {}):
            unused, number = f"{name}_{number}", number + 1
        into[unused] = kind
        return unused

    # ---- a frame ------------------------------------------------------------------------------------------

    def _frame(self, command: _Command) -> _Frame:
        """Raises _CannotSayError; why is told."""
        elements = _joined([*command.elements, Literal(command.terminator)])
        body: list[str] = []
        values: dict[str, str] = {}
        for place, element in enumerate(elements):
            if isinstance(element, Literal):
                body += _constants(element.data)
                continue
            follows = elements[place + 1] if place + 1 < len(elements) else None
            end = follows.data if isinstance(follows, Literal) else b""
            try:
                segment, kind = _segment(element, end, command.word == "in")
            except _CannotSayError as error:
                self.left_out.append(
                    Problem(element.at, f"{error}: the protocol is left out", "write its frames by hand")
                )
                raise
            if not kind:
                body.append(f"{{{segment}}}")
                continue
            name = f"arg_{element.about}" if element.kind == "argument" else _field_name(element)
            name = self._unused(name, values, kind)
            body.append(f"{{field: {name}, {segment}}}")
        if not body:
            self.left_out.append(Problem(command.at, "a command without bytes", "write what is sent"))
            raise _CannotSayError
        return _Frame(body, values)


_START = {"number": "0", "decimal": "0", "text": "\"''\""}


def _takes(values: dict[str, str]) -> str:
    return ", ".join(f"{one}: {{{'' if kind == 'number' else f'type: {kind}'}}}" for one, kind in values.items())


def _field_name(element: Converter) -> str:
    name = re.sub(r"[^a-z0-9_]", "_", element.redirect.lower()).strip("_")
    return name if re.match(r"[a-z]", name) else "value"


def _number(elements: Sequence[Element]) -> int:
    """A number of ms: one byte as a number, or a greater one."""
    first = elements[0] if elements else None
    if isinstance(first, Literal) and first.data:
        return first.data[0]
    return first.width if isinstance(first, Converter) and first.kind == "number" else 0


def _joined(elements: Sequence[Element]) -> list[Element]:
    found: list[Element] = []
    for element in elements:
        if isinstance(element, Literal) and found and isinstance(found[-1], Literal):
            found[-1] = Literal(found[-1].data + element.data)
        elif not isinstance(element, Literal) or element.data:
            found.append(element)
    return found


def _constants(data: bytes) -> list[str]:
    """Runs of printable bytes as text, others in hex."""
    runs = re.findall(rb"[ -~]+|[^ -~]+", data)
    return [
        f"{{text: {json.dumps(run.decode('ascii'))}}}"
        if run[0] in range(0x20, 0x7F)
        else f"{{const: {run.hex(' ').upper()}}}"
        for run in runs
    ]


CHECKS = {"sum": "sum8", "sum8": "sum8", "xor": "xor8", "xor8": "xor8"}
"""The checks of StreamDevice that are taken over, by their names in framekit."""


def _segment(one: Converter, end: bytes, reads: bool) -> tuple[str, str]:
    """The keys of a segment, and the kind of its value, '' for none. `end`: the bytes behind it.

    Raises _CannotSayError.
    """
    until = f"end: [{end.hex(' ').upper()}]" if end else ""
    letter, width = one.kind, one.width
    if "*" in one.flags or letter in ("skip", "regex", "number") or "?" in one.flags or "=" in one.flags:
        raise _CannotSayError(f"%{one.flags}{letter}, which no segment is like")
    if letter == "c":
        return f"type: ascii, size: {width or 1}", "text"
    if letter in ("s", "set", "words", "argument"):
        if until:
            return f"type: ascii, {until}", "text"
        if width and not reads:
            return f"type: ascii, size: {width}", "text"
        raise _CannotSayError("a text with nothing behind it that ends it")
    if letter in ("x", "X") and width:
        return f"type: hex, size: {width}" + (", case: lower" if letter == "x" else ""), "number"
    if letter in ("d", "i", "u", "f", "e", "E", "g", "G"):
        return _decimal(one, until, reads)
    if letter in ("r", "R") and (width or 1) in ((1, 2, 4, 8) if letter == "r" else (4, 8)):
        size = 8 * (width or 1)
        form = f"f{size}" if letter == "R" else f"u{size}" if "0" in one.flags else f"i{size}"
        order = ", order: little" if "#" in one.flags and size > 8 else ""
        return f"type: {form}{order}", "decimal" if letter == "R" else "number"
    if letter == "check" and one.about.lower() in CHECKS and not one.precision:
        digits = ", as: hex" if "0" in one.flags else ""
        return f"check: {CHECKS[one.about.lower()]}{digits}, over: {width}..here", ""
    shown = f"%<{one.about}>" if letter == "check" else f"%{letter}"
    raise _CannotSayError(f"{shown}, which no segment is like")


def _decimal(one: Converter, until: str, reads: bool) -> tuple[str, str]:
    """A number in decimal digits. What is read may have any number of decimals."""
    is_whole = one.kind in ("d", "i", "u")
    keys = ["type: decimal"]
    if one.width and (not until or not reads):
        keys.append(f"size: {one.width}" + ("" if "0" in one.flags else ", pad: 20"))
    elif until:
        keys.append(until)
    else:
        raise _CannotSayError("a number with nothing behind it that ends it")
    if "+" in one.flags:
        keys.append("sign: always")
    elif one.kind == "u":
        keys.append("sign: never")
    if one.kind in ("e", "E"):
        keys += [f"decimals: {6 if one.precision is None else one.precision}", "exponent: 2"]
    elif not is_whole:
        keys.append(
            "decimals: any"
            if reads or one.kind in ("g", "G")
            else f"decimals: {6 if one.precision is None else one.precision}"
        )
    return ", ".join(keys), "number" if is_whole else "decimal"
