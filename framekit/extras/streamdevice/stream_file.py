"""Reader of protocol files of EPICS StreamDevice: protocols, their commands, and the settings of each.

Variables are replaced where they are used, and protocols where others use them, as StreamDevice does. A text that is no
protocol file is an error; a construct that StreamDevice refuses only where it is used is reported, and its protocol
left out. All work is counted, so that a small file cannot cause much work. Source: StreamDevice 2, "Protocol Files" and
"Format Converters".
"""

from __future__ import annotations

import re
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from framekit.definition.load.reader import CONTROL_NAMES
from framekit.definition.problems import DefinitionError, Position, Problem, is_nearly

MOST_PIECES = 20_000
"""Largest number of commands and text pieces of all protocols together, including those that they use."""
MOST_SIGNS = 4_000_000
"""Largest number of characters and words of all values together, after the replacement of variables."""

DEEPEST = 20
"""Largest depth of nested blocks; a handler in a protocol has depth 2."""
BYTE_ORDER_MARK = "\xef\xbb\xbf"
"""Byte order mark, with which some editors begin a file."""
_WORD = r"""[^\s,;{}=()$'"+\-*/#]+"""
_TOKEN = re.compile(
    rf"""(?P<blank>(?:\s+|\#[^\n]*)+)|(?P<string>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')"""
    rf"""|(?P<open>"(?:\\.|[^"\\\n])*|'(?:\\.|[^'\\\n])*)"""
    rf"""|(?P<variable>\$(?:\{{[^{{}}=;"'\n]*\}}|[0-9]|{_WORD}))|(?P<sign>[{{}};=,()+\-*/])|(?P<word>{_WORD})"""
    r"""|(?P<wrong>.)""",
)
_ESCAPE = re.compile(
    rf"""\\(?:x(?P<hex>[0-9A-Fa-f]{{1,2}})|(?P<octal>0[0-7]{{0,3}})|(?P<decimal>[1-9][0-9]{{0,2}})"""
    rf"""|\$(?P<variable>\{{[^{{}}=;"'\n]*\}}|[0-9]|{_WORD})|(?P<sign>[\s\S]))"""
)
_FORMAT = re.compile(r"(?P<flags>[*# +0?=!-]*)(?P<width>\d{0,6})(?:\.(?P<precision>\d{1,6}))?(?P<kind>[\s\S])")
_QUOTE = re.compile(r"""\\[\s\S]|["']""")
_CLOSED_BY = {"[": "]", "{": "}", "<": ">", "/": "/", "T": ")"}
_LETTERS = frozenset("diuoxXcsfeEgGbrRDm")

_NO_EFFECT = {
    "separator": "only lists have it: write repeat: with a separator where a protocol reads or writes a list",
    "locktimeout": "a run has its own time limits",
    "writetimeout": "a run has its own time limits",
    "pollperiod": "say in a run how often a value is read",
}
_SETTINGS = (
    "terminator", "interminator", "outterminator", "replytimeout", "readtimeout", "maxinput", "extrainput", *_NO_EFFECT,
)  # fmt: skip
_ESCAPES = {"a": 7, "b": 8, "t": 9, "n": 10, "r": 13, "e": 27}
_BYTES = {name.lower(): code for name, code in CONTROL_NAMES.items() if name not in ("SP", "XON", "XOFF")}
_BYTES |= {"nl": 10, "np": 12, "ff": 12}
COMMANDS = ("out", "in", "wait", "event", "exec", "connect", "disconnect")
HANDLERS = ("@init", "@mismatch", "@writetimeout", "@replytimeout", "@readtimeout")


class _Token(NamedTuple):
    """A token. `spaced`: whether a space precedes it."""

    kind: str
    text: str
    at: Position
    spaced: bool


class Literal(NamedTuple):
    """Literal bytes."""

    data: bytes
    at: Position


class AnyByte(NamedTuple):
    """Any byte."""

    at: Position


class StreamArgument(NamedTuple):
    r"""`\$1` to `\$9`: a text that the user of the protocol provides."""

    number: int
    at: Position


class Converter(NamedTuple):
    """A value in the text: its letter, or `[`, `{` or `<` with the enclosed text.

    `about` has escaped bytes as characters from ESCAPED on. `redirect`: the name in round brackets.
    """

    kind: str
    at: Position
    flags: str = ""
    width: int = 0
    precision: int | None = None
    about: str = ""
    redirect: str = ""

    def __str__(self) -> str:
        width = str(self.width) if self.width else ""
        precision = "" if self.precision is None else f".{self.precision}"
        about = plain_text(self.about)
        closed = (
            f"{about if len(about) < 20 else about[:20] + '…'}{_CLOSED_BY.get(self.kind, '')}" if self.about else ""
        )
        return f"%{self.flags[:8]}{width}{precision}{self.kind}{closed}"


Element = Literal | AnyByte | StreamArgument | Converter

ESCAPED = 0xE000
_ARGUMENT = 0xE100
_SKIP = "\ue200"
_SPACE = "\ue201"
_LONGEST = 40
_IN_NAMES = ("+", "-", "*", "/")


def named(text: str) -> str:
    """Return a name for a message, shortened if it is long."""
    return repr(text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…")


def plain_text(text: str) -> str:
    """Return the text of a converter with escaped bytes as characters, and arguments as written."""

    def shown(code: int) -> str:
        if _ARGUMENT <= code < _ARGUMENT + 10:
            return f"\\${code - _ARGUMENT}"
        return chr(code - ESCAPED) if ESCAPED <= code < ESCAPED + 256 else "?" if code >= ESCAPED else chr(code)

    return "".join(shown(ord(one)) for one in text)


@dataclass(frozen=True, slots=True)
class StreamCommand:
    """A command. `elements`: of `out` and `in`; `ms`: of `wait`."""

    word: str
    at: Position
    elements: tuple[Element, ...] = ()
    ms: int = 0


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """Settings of a protocol; times in ms.

    A terminator is None if not set. `ignores_extra`: additional input is accepted.
    """

    in_terminator: bytes | None = None
    out_terminator: bytes | None = None
    reply_timeout: int = 1000
    read_timeout: int = 100
    most_input: int = 0
    ignores_extra: bool = False


@dataclass(frozen=True, slots=True)
class StreamProtocol:
    """A protocol. `init`: the commands of its handler @init, of its own or of the file, if any."""

    name: str
    at: Position
    settings: StreamSettings
    commands: tuple[StreamCommand, ...]
    init: tuple[StreamCommand, ...] = ()
    init_at: Position | None = None


@dataclass(frozen=True, slots=True)
class StreamFile:
    """A file. `left_out`: problems noted while reading; the protocols they name are not among `protocols`."""

    protocols: tuple[StreamProtocol, ...]
    left_out: tuple[Problem, ...]


def read_stream_file(text: str, file: str) -> StreamFile:
    """Return the protocols of a file. Raises DefinitionError, with every error, for a text that is no such file."""
    reader = _StreamReader(text.removeprefix(BYTE_ORDER_MARK), file)
    try:
        reader.read()
    except DefinitionError as error:
        raise DefinitionError([*reader.errors, *error.problems]) from None
    if reader.errors:
        raise DefinitionError(reader.errors)
    return StreamFile(tuple(reader.made), tuple(reader.left_out))


class _Raw(NamedTuple):
    """A command as written; its variables are resolved in the protocol that uses it."""

    word: str
    at: Position
    tokens: tuple[_Token, ...]


class _Variable(NamedTuple):
    """The value of a variable; `spaced`: a space precedes its semicolon."""

    tokens: tuple[_Token, ...]
    at: Position
    spaced: bool


@dataclass(slots=True)
class _Body:
    """A protocol, or the statements outside of all protocols, while being read."""

    name: str
    at: Position
    commands: list[_Raw] = field(default_factory=list)
    variables: dict[str, _Variable] = field(default_factory=dict)
    handlers: dict[str, tuple[Position, list[_Raw]]] = field(default_factory=dict)


def _escaped(match: re.Match[str]) -> str:
    """Escape a literal quote within quotes; existing escapes stay."""
    return match[0] if len(match[0]) > 1 else f"\\{match[0]}"


class _ToldError(Exception):
    """Raised for a construct that is an error at its place of use, or that has no meaning outside of an IOC."""

    def __init__(self, at: Position, what: str, todo: str) -> None:
        super().__init__(what)
        self.problem = Problem(at, what, todo)


class _StreamReader:
    """Reads all protocols of a file; it continues after errors."""

    def __init__(self, text: str, file: str) -> None:
        self.errors: list[Problem] = []
        self.left_out: list[Problem] = []
        self.made: list[StreamProtocol] = []
        self._file = file
        self._tokens = list(self._cut(text))
        self._place = 0
        self._pieces = 0
        self._signs = 0
        self._deep = 0
        self._whole = _Body("", Position(file, 1, 1))
        self._set: list[tuple[str, Position]] = []  # variables of the file's own
        self._used: set[str] = set()
        self._commands: dict[str, list[_Raw]] = {}

    def _cut(self, text: str) -> Iterator[_Token]:
        line, begin, spaced = 1, 0, False
        for match in _TOKEN.finditer(text):
            kind, found = str(match.lastgroup), match[0]
            at = Position(self._file, line, match.start() - begin + 1)
            if kind == "open":
                self.errors.append(Problem(at, f"the text {named(found)} has no end", "close it on its line"))
            elif kind == "wrong":
                self.errors.append(Problem(at, f"{named(found)} begins nothing", "remove it"))
            elif kind != "blank":
                yield _Token(kind, found, at, spaced)
            spaced = kind == "blank"
            if (lines := found.count("\n")) > 0:
                line, begin = line + lines, match.start() + found.rindex("\n") + 1
        yield _Token("end", "", Position(self._file, line, len(text) - begin + 1), spaced)

    def _count(self, at: Position, pieces: int = 0, signs: int = 0) -> None:
        self._pieces += pieces
        self._signs += signs
        if self._pieces > MOST_PIECES or self._signs > MOST_SIGNS:
            most, what = (MOST_PIECES, "commands and pieces") if self._pieces > MOST_PIECES else (MOST_SIGNS, "signs")
            what = f"all protocols together have more than {most} {what}, with what they take from others"
            raise DefinitionError([Problem(at, what, "divide the file")])

    # ---- statements ---------------------------------------------------------------------------------------

    def _next(self) -> _Token:
        token = self._tokens[self._place]
        if token.kind != "end":
            self._place += 1
        return token

    def _peek(self) -> _Token:
        return self._tokens[self._place]

    def _wrong(self, at: Position, what: str, todo: str) -> None:
        """Note an error and skip the rest of the statement."""
        self.errors.append(Problem(at, what, todo))
        while self._peek().kind != "end" and self._peek().text not in (";", "}", "{"):
            self._next()

    def _head(self) -> _Token:
        """Return the head of a statement. Its name may contain characters that end a word elsewhere."""
        token = self._next()
        if token.kind != "word":
            return token
        parts = [token.text]
        while not self._peek().spaced and (self._peek().kind == "word" or self._peek().text in _IN_NAMES):
            parts.append(self._next().text)
        return token._replace(text="".join(parts))

    def read(self) -> None:
        while (token := self._head()).kind != "end":
            follows = self._peek().text
            if token.text == ";":
                continue
            if token.kind != "word" or follows not in ("=", "{"):
                self._wrong(
                    token.at, f"{named(token.text)} is no protocol and no setting", "write NAME { … } or NAME = …;"
                )
                if self._peek().text == "{":  # whose head this was
                    self._next()
                    self._block(_Body("", token.at), [], token)
            elif follows == "=":
                self._assignment(token, self._whole)
            else:
                self._next()
                if token.text.startswith("@"):
                    self._handler(token, self._whole)
                else:
                    self._protocol(token)
        for name, at in self._set:
            if name not in self._used:
                near = [one for one in _SETTINGS if is_nearly(name[:_LONGEST], one)] if len(self._set) < 100 else []
                todo = f"did you mean {near[0]}?" if near else "use it, or remove it"
                self.left_out.append(Problem(at, f"nothing uses the variable {named(name)}", todo, warning=True))
        if not self._commands and not self.errors:
            self.errors.append(Problem(Position(self._file, 1, 1), "no protocol is in this file", "write NAME { … }"))

    def _protocol(self, name: _Token) -> None:
        body = _Body(name.text, name.at)
        if not name.text[0].isalpha():
            self.errors.append(
                Problem(name.at, f"{named(name.text)} is no name of a protocol", "begin it with a letter")
            )
        if name.text.lower() in self._commands:
            self.errors.append(Problem(name.at, f"there are two protocols {named(name.text)}", "give one another name"))
        self._block(body, body.commands, name)
        self._commands[name.text.lower()] = body.commands
        self._make(body)

    def _handler(self, name: _Token, body: _Body) -> None:
        commands: list[_Raw] = []
        body.handlers[name.text.lower()] = name.at, commands
        self._block(None, commands, name)
        if name.text.lower() not in HANDLERS:
            what = f"there is no handler {named(name.text)}"
            self.errors.append(Problem(name.at, what, f"known: {', '.join(HANDLERS)}"))
        elif name.text.lower() != "@init":
            self.left_out.append(
                Problem(
                    name.at, f"the handler {name.text}: a failed exchange ends here", "write a sequence that does it"
                )
            )

    def _block(self, body: _Body | None, commands: list[_Raw], name: _Token) -> None:
        """Read statements up to the closing brace; without `body` they are those of a handler."""
        self._deep += 1
        if self._deep > DEEPEST:
            what = f"blocks stand deeper inside each other than {DEEPEST}"
            raise DefinitionError([Problem(name.at, what, "end each with }")])
        self._statements(body, commands, name)
        self._deep -= 1

    def _statements(self, body: _Body | None, commands: list[_Raw], name: _Token) -> None:
        while (token := self._head()).text != "}":
            if token.kind == "end":
                self.errors.append(Problem(name.at, f"{named(name.text)} has no end", "write }"))
                return
            follows = self._peek().text
            if token.text == ";":
                continue
            if token.text == "{":
                self.errors.append(
                    Problem(token.at, "a block has no name here", f"end {named(name.text)} with }} before")
                )
                self._block(body, [], token)
            elif token.kind != "word" or not (token.text[0].isalpha() or token.text[0] == "@"):
                self._wrong(token.at, f"{named(token.text)} is no command", f"known: {', '.join(COMMANDS)}")
            elif follows == "=" and body is not None and token.text[0] != "@":
                self._assignment(token, body)
            elif token.text[0] == "@" and follows == "{" and body is not None:
                self._next()
                self._handler(token, body)
            elif follows in ("=", "{") or token.text[0] == "@":
                self._wrong(token.at, f"{named(token.text)} has no place here", "write a command")
            else:
                self._command(token, commands)

    def _command(self, token: _Token, commands: list[_Raw]) -> None:
        word = token.text.lower()
        if self._peek().text in (";", "}") and word in self._commands:
            taken = self._commands[word]
            self._count(token.at, pieces=len(taken))
            commands.extend(taken)
            return
        self._count(token.at, pieces=1)
        tokens, _ = self._values()
        commands.append(_Raw(word, token.at, tokens))

    def _assignment(self, token: _Token, body: _Body) -> None:
        self._next()  # =
        tokens, spaced = self._values()
        try:
            found = tuple(self._expanded(tokens, self._whole.variables))
        except _ToldError as told:
            self.errors.append(told.problem)
            return
        name = token.text.lower()
        body.variables[name] = _Variable(found, token.at, spaced)
        if name not in _SETTINGS:
            self._set.append((name, token.at))
        elif name in _NO_EFFECT:
            self.left_out.append(Problem(token.at, f"the setting {token.text}", _NO_EFFECT[name], warning=True))

    def _values(self) -> tuple[tuple[_Token, ...], bool]:
        """Return the tokens up to the next semicolon, and whether a space precedes it."""
        begin = self._place
        while (token := self._peek()).text not in (";", "}") and token.kind != "end":
            if token.text in ("{", "="):
                self._wrong(token.at, f"{named(token.text)} has no place here", "end the statement before with ;")
                break
            self._next()
        if token.kind == "end":
            self.errors.append(Problem(token.at, "a statement has no end", "write ;"))
        return tuple(self._tokens[begin : self._place]), self._peek().spaced

    # ---- variables ----------------------------------------------------------------------------------------

    def _variable(self, name: str, at: Position, variables: Mapping[str, _Variable]) -> _Variable:
        name = name.removeprefix("{").removesuffix("}").strip()
        self._used.add(name.lower())
        if name.lower() not in variables:
            todo = "set it before, or write ${NAME} where other signs follow"
            raise _ToldError(at, f"there is no variable {named(name)}", todo)
        return variables[name.lower()]

    def _expanded(self, tokens: Sequence[_Token], variables: Mapping[str, _Variable]) -> Iterator[_Token]:
        """Yield the tokens with variables replaced by their tokens; variables within strings are replaced in the
        string.
        """
        for token in tokens:
            self._count(token.at, signs=1)
            if token.kind == "variable" and not token.text[1].isdigit():
                value = self._variable(token.text[1:], token.at, variables)
                self._count(token.at, signs=len(value.tokens))
                yield from (one._replace(at=token.at) for one in value.tokens)
            elif token.kind == "string" and "\\$" in token.text:
                yield self._with_variables(token, variables)
            else:
                yield token

    def _with_variables(self, token: _Token, variables: Mapping[str, _Variable]) -> _Token:
        """Return a string with its variables replaced by their texts, quotes included; arguments stay."""
        quote, inside = token.text[0], token.text[1:-1]
        parts, place = [quote], 0
        for match in _ESCAPE.finditer(inside):
            name = match["variable"]
            if name is None or name[0].isdigit():
                continue
            value = self._variable(name, token.at, variables)
            whole = "".join(" " * one.spaced + one.text for one in value.tokens).lstrip(" ") + " " * value.spaced
            self._count(token.at, signs=len(whole))
            parts += [inside[place : match.start()], _QUOTE.sub(_escaped, whole)]
            place = match.end()
        if not place:
            return token
        return token._replace(kind="filled", text="".join((*parts, inside[place:], quote)))

    # ---- meaning of the commands of a protocol -----------------------------------------------------------

    def _make(self, body: _Body) -> None:
        variables = ChainMap(body.variables, self._whole.variables)
        handlers = ChainMap(body.handlers, self._whole.handlers)
        whom = f"protocol {named(body.name)}"
        settings = self._settings(variables, whom)
        commands = self._meant(body.commands, variables, whom)
        if settings is None or commands is None:
            return
        init_at, raw = handlers.get("@init", (None, []))
        init = self._meant(raw, variables, f"the handler @init of {named(body.name)}")
        self.made.append(StreamProtocol(body.name, body.at, settings, commands, init or (), init_at))

    def _tell(self, told: _ToldError, whom: str) -> None:
        one = told.problem
        self.left_out.append(Problem(one.at, f"{one.what}: {whom} is left out", one.todo))

    def _meant(
        self, commands: Sequence[_Raw], variables: Mapping[str, _Variable], whom: str
    ) -> tuple[StreamCommand, ...] | None:
        """Return the commands; None if they are invalid, which is noted."""
        found: list[StreamCommand] = []
        told_of = len(self.left_out)
        for raw in commands:
            try:
                if raw.word in ("out", "in"):
                    elements = tuple(self._elements(raw.tokens, variables, reads=raw.word == "in"))
                    self._count(raw.at, pieces=len(elements))
                    found.append(StreamCommand(raw.word, raw.at, elements))
                elif raw.word == "wait":
                    found.append(StreamCommand("wait", raw.at, ms=self._number(raw.tokens, raw.at, variables)))
                elif raw.word in COMMANDS:
                    what = f"the command {raw.word}, which no definition has"
                    raise _ToldError(raw.at, what, "write what the device needs by hand")
                else:
                    known = f"known: {', '.join(COMMANDS)}, and the protocols before"
                    raise _ToldError(raw.at, f"there is no command or protocol {named(raw.word)}", known)
            except _ToldError as told:
                self._tell(told, whom)
        return tuple(found) if len(self.left_out) == told_of else None

    def _settings(self, variables: Mapping[str, _Variable], whom: str) -> StreamSettings | None:
        """Return the settings; None if they are invalid, which is noted."""

        def number(name: str, default: int) -> int:
            if name not in variables:
                return default
            return self._number(variables[name].tokens, variables[name].at, variables)

        def terminator(name: str) -> bytes | None:
            value = variables.get(name, variables.get("terminator"))
            return None if value is None else self._terminator(value, variables)

        try:
            extra = "error"
            if "extrainput" in variables:
                extra = "".join(one.text.lower() for one in variables["extrainput"].tokens)
                if extra not in ("error", "ignore"):
                    raise _ToldError(
                        variables["extrainput"].at, f"{named(extra)} is no ExtraInput", "write Error or Ignore"
                    )
            return StreamSettings(
                terminator("interminator"), terminator("outterminator"), number("replytimeout", 1000),
                number("readtimeout", 100), number("maxinput", 0), extra == "ignore",
            )  # fmt: skip
        except _ToldError as told:
            self._tell(told, whom)
            return None

    def _terminator(self, value: _Variable, variables: Mapping[str, _Variable]) -> bytes:
        found = bytearray()
        for code in self._codes(value.tokens, variables)[0]:
            number = ord(code)
            if ESCAPED <= number < ESCAPED + 256:
                number -= ESCAPED
            elif number > 255:
                raise _ToldError(value.at, "a terminator with an argument or any byte", "write its frames by hand")
            found.append(number)
        return bytes(found)

    def _number(self, tokens: Sequence[_Token], at: Position, variables: Mapping[str, _Variable]) -> int:
        """Return a number in the notation of C: 0x10, 010, 16."""
        text = "".join(one.text for one in self._expanded(tokens, variables))
        match = re.fullmatch(r"(0[xX][0-9a-fA-F]{1,8})|(0[0-7]{0,10})|([1-9][0-9]{0,8})", text)
        if match is None:
            raise _ToldError(at, f"{named(text)} is no number of milliseconds or bytes", "write such a number")
        return int(text, 16 if match[1] else 8 if match[2] else 10)

    # ---- texts --------------------------------------------------------------------------------------------

    def _codes(self, tokens: Sequence[_Token], variables: Mapping[str, _Variable]) -> tuple[list[str], list[Position]]:
        """Return a text as a character for each byte, and their places.

        A character that an escape or a number gives has a code from ESCAPED on, an argument from _ARGUMENT on.
        """
        codes: list[str] = []
        places: list[Position] = []

        def add(code: str, at: Position) -> None:
            self._count(at, signs=1)
            codes.append(code)
            places.append(at)

        negative: _Token | None = None
        for token in self._expanded(tokens, variables):
            if negative is not None and (token.kind != "word" or token.spaced):
                raise _ToldError(negative.at, "'-' stands before no number", "write it in quotes")
            if token.kind in ("string", "filled"):
                self._in_quotes(token, add)
            elif token.text == "-":
                negative = token
                continue
            elif token.kind == "variable":
                what = f"the argument {token.text} outside of quotes may be any bytes"
                raise _ToldError(token.at, what, "write \\$1 within quotes")
            elif token.kind == "word":
                add(self._byte(token, negative is not None), token.at)
            elif token.text != ",":
                raise _ToldError(token.at, f"{named(token.text)} is no text", "write it in quotes")
            negative = None
        if negative is not None:
            raise _ToldError(negative.at, "'-' stands before no number", "write it in quotes")
        return codes, places

    def _byte(self, token: _Token, negative: bool) -> str:
        word = token.text.lower()
        if word in ("skip", "?") and not negative:
            return _SKIP
        if word in _BYTES and not negative:
            return chr(ESCAPED + _BYTES[word])
        match = re.fullmatch(r"(0x[0-9a-f]{1,8})|(0[0-7]{0,10})|([1-9][0-9]{0,8})", word)
        number = 256 if match is None else int(word, 16 if match[1] else 8 if match[2] else 10)
        number = -number if negative else number
        if not -128 <= number <= 255:
            shown = f"{'-' * negative}{token.text}"
            todo = "write a string, the name of a byte, or a number to 255"
            raise _ToldError(token.at, f"{named(shown)} is no byte", todo)
        return chr(ESCAPED + (number & 0xFF))

    def _in_quotes(self, token: _Token, add: Callable[[str, Position], None]) -> None:
        text, place = token.text[1:-1], 0
        while place < len(text):
            column = token.at.column + (1 + place if token.kind == "string" else 0)
            at = Position(token.at.file, token.at.line, column)
            match = _ESCAPE.match(text, place)
            if match is None:
                add(text[place], at)
                place += 1
                continue
            place = match.end()
            if match["variable"] is not None:
                number = int(match["variable"])  # other variables are replaced before
                if not number:
                    raise _ToldError(at, "$0, the name of the protocol", "write the name")
                add(chr(_ARGUMENT + number), at)
            elif match["sign"] == "?":
                add(_SKIP, at)
            elif match["sign"] == "_":
                add(_SPACE, at)
            elif match["sign"] == "x":
                raise _ToldError(at, "no hex digits are behind \\x", "write \\x0D")
            else:
                bases = (("hex", 16), ("octal", 8), ("decimal", 10))
                number = next((int(match[name], base) for name, base in bases if match[name]), -1)
                if number > 255:
                    raise _ToldError(at, f"{match[0]} is no byte", "write a number to 255")
                sign = match["sign"] or ""
                add(chr(ESCAPED + (number if number >= 0 else _ESCAPES.get(sign, ord(sign) & 0xFF))), at)

    def _elements(self, tokens: Sequence[_Token], variables: Mapping[str, _Variable], reads: bool) -> Iterator[Element]:
        codes, places = self._codes(tokens, variables)
        text, place, data, since = "".join(codes), 0, bytearray(), 0

        def literal() -> Iterator[Literal]:
            if data:
                yield Literal(bytes(data), places[since])
                data.clear()

        while place < len(text):
            sign, number = text[place], ord(text[place])
            if sign == "%" and text[place + 1 : place + 2] != "%":
                yield from literal()
                converter, place = self._converter(text, place, places[place])
                yield converter
                continue
            if not data:
                since = place
            if sign == "%":
                data.append(0x25)
                place += 1
            elif number < 256 or ESCAPED <= number < ESCAPED + 256:
                data.append(number & 0xFF)
            elif sign == _SPACE and not reads:
                data.append(0x20)
            elif sign == _SPACE:
                what = "\\_ takes any space, or none, which no segment is like"
                raise _ToldError(places[place], what, "write the space that comes")
            elif sign == _SKIP:
                yield from literal()
                if not reads:
                    raise _ToldError(places[place], "any byte cannot be sent", "write which")
                yield AnyByte(places[place])
            else:
                yield from literal()
                yield StreamArgument(number - _ARGUMENT, places[place])
            place += 1
        yield from literal()

    def _converter(self, text: str, place: int, at: Position) -> tuple[Converter, int]:
        """Return the converter whose % is at a place, and its end."""
        redirect, place = "", place + 1
        if text[place : place + 1] == "(":
            end = text.find(")", place)
            if end < 0:
                raise _ToldError(at, "the name of a field has no end", "write )")
            redirect, place = text[place + 1 : end], end + 1
        match = _FORMAT.match(text, place)
        if match is None:
            raise _ToldError(at, "a percent sign with nothing behind it", "write %% for the sign")
        kind, place, about = match["kind"], match.end(), ""
        if kind == "B":
            about, place = text[place : place + 2], min(place + 2, len(text))
        elif kind in _CLOSED_BY:
            begin = place + (kind == "[") * (1 + (text[place : place + 1] == "^"))  # ] may come first
            end = text.find(_CLOSED_BY[kind], begin)
            if end < 0:
                raise _ToldError(at, f"%{kind} has no end", f"write {_CLOSED_BY[kind]}")
            about, place = text[place:end], end + 1
        elif kind not in _LETTERS:
            what = f"%{plain_text(kind)} is no converter of StreamDevice's own"
            raise _ToldError(at, what, "write %% for a percent sign")
        width, precision = int(match["width"] or 0), match["precision"]
        flags = match["flags"]
        found = Converter(kind, at, flags, width, None if precision is None else int(precision), about, redirect)
        return found, place
