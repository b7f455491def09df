"""What several verbs share: naming a protocol, assignments, hex input, tables. No verb's work is done here."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.main import WrongWords
from framekit.codec.shown import explain

if TYPE_CHECKING:
    from framekit.codec.stored import StoredCodec
    from framekit.definition.model.protocol import Protocol
    from framekit.definition.problems import Problem
    from framekit.link.scope import Scope


def add_protocol(parser: argparse.ArgumentParser, **options: Any) -> None:
    """The argument PROTOCOL: a shipped name, a name beside the current folder, or a file."""
    parser.add_argument("protocol", metavar="PROTOCOL", help="name of a shipped protocol, or a YAML file", **options)


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")


def add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE",
        help="value of a parameter or a variable that the bytes depend on; may be repeated",
    )  # fmt: skip


def told(problem: Problem) -> str:
    """A problem as it is printed: with the path as seen from the current folder."""
    from dataclasses import replace

    return str(replace(problem, at=replace(problem.at, file=near(problem.at.file))))


def status_of(problems: Iterable[Problem]) -> int:
    """The exit status: 1 for what is wrong in files; 2 where nothing else is wrong than names on the command line."""
    wrong = [problem for problem in problems if not problem.warning]
    if not wrong:
        return 0
    return 1 if any(problem.at.line for problem in wrong) else WrongWords.status


def told_once(problems: Iterable[Problem]) -> list[str]:
    """Problems as they are printed; a warning that comes again in the same file is one line, with the other places."""
    lines: dict[tuple[object, ...], list[Problem]] = {}
    for problem in problems:
        same = (problem.at.file, problem.what, problem.todo) if problem.warning else (len(lines),)
        lines.setdefault(same, []).append(problem)
    return [told(first) + _others(others) for first, *others in lines.values()]


def _others(others: list[Problem]) -> str:
    """Where else the same is: ` (also in lines 16 and 17)`."""
    *some, last = [str(one.at.line) for one in others] or [""]
    if not last:
        return ""
    return f" (also in line {last})" if not some else f" (also in lines {', '.join(some)} and {last})"


def near(file: str) -> str:
    """A path relative to the current folder, where it lies below that."""
    path = Path(file)
    return str(path.relative_to(Path.cwd())) if path.is_absolute() and path.is_relative_to(Path.cwd()) else file


def load(name: str) -> Protocol:
    """The protocol of a command line. Raises DefinitionError; warnings go to standard error."""
    from framekit.definition.load import load_protocol

    protocol = load_protocol(name, Path.cwd())
    _warn(protocol)
    return protocol


def load_codec(name: str) -> StoredCodec:
    """Its functions alone, which is quicker; the definition itself is read when somebody asks for it."""
    from framekit.codec.stored import stored_codec

    codec = stored_codec(name, Path.cwd())
    if codec.warned:
        _warn(codec.protocol)
    return codec


def _warn(protocol: Protocol) -> None:
    for warning in protocol.warnings:
        print(told(warning), file=sys.stderr)


def assignment(text: str) -> tuple[str, Any]:
    """`NAME=VALUE`; the value is JSON where it is an object, a list or a quoted string, else plain text."""
    import json

    name, equals, value = text.partition("=")
    if not equals or not name:
        raise WrongWords(f"'{text}' is not NAME=VALUE")
    if value[:1] in ("{", "[", '"'):
        try:
            return name, json.loads(value)
        except json.JSONDecodeError as error:
            raise WrongWords(f"the value of '{name}' is not JSON: {error.msg} at character {error.pos + 1}") from None
    return name, value


def scope_of(protocol: Protocol, settings: Iterable[str], **options: Any) -> Scope:
    """Names for a codec: parameters and state with the given settings. Raises WrongWords for those that do not fit."""
    from framekit.link.parameters import ParameterError
    from framekit.link.scope import Scope

    given = dict(assignment(text) for text in settings)
    try:
        scope = Scope(protocol, params={n: v for n, v in given.items() if n in protocol.params}, **options)
        for name, value in given.items():
            if name not in protocol.params:
                set_variable(scope, protocol, name, value)
    except ParameterError as error:
        raise WrongWords(str(error)) from None
    return scope


def set_variable(scope: Scope, protocol: Protocol, name: str, value: Any) -> None:
    """Sets a state variable from its text."""
    from framekit.definition.load.scalars import parse_bytes, parse_number
    from framekit.definition.problems import did_you_mean
    from framekit.definition.times import parse_time

    if name not in protocol.state:
        hint = did_you_mean(name, [*protocol.params, *protocol.state])
        raise WrongWords(f"'{protocol.name}' has no parameter or variable '{name}'" + (f" – {hint}" if hint else ""))
    parsers: dict[str, Callable[[str], Any]] = {"bytes": parse_bytes, "text": str, "time": parse_time}
    parse = parsers.get(protocol.state[name].type, parse_number)
    try:
        scope.set(name, parse(value) if isinstance(value, str) else value)
    except (ValueError, TypeError) as error:
        raise WrongWords(f"variable '{name}': {explain(error)}") from None


def duration_of(text: str | None) -> int | None:
    """The time of `--for` (ns); None where there is none. Raises WrongWords."""
    from framekit.definition.times import parse_time

    if text is None:
        return None
    try:
        return parse_time(text)
    except ValueError as error:
        raise WrongWords(f"--for: {error}") from None


def why_not(error: OSError) -> str:
    """Why the system refused something, and about which file."""
    text = error.strerror or str(error)
    return f"{near(str(error.filename))}: {text}" if error.filename is not None else text


def hex_bytes(text: str) -> bytes:
    """Bytes from hex digits with any spacing; `-` reads standard input. Raises WrongWords."""
    if text == "-":
        text = sys.stdin.read()
    try:
        return bytes.fromhex("".join(text.replace("0x", " ").replace(",", " ").replace(":", " ").split()))
    except ValueError:
        raise WrongWords("these are not bytes – write pairs of hex digits") from None


def existing(file: Path) -> Path:
    """A file to be read. Raises WrongWords where there is none."""
    if file.is_dir():
        raise WrongWords(f"{file}: this is a folder, not a file – name a file in it")
    if not file.exists():
        raise WrongWords(f"{file}: there is no such file – check its name and folder")
    return file


def spaced(data: bytes) -> str:
    """Upper-case hex pairs."""
    return data.hex(" ").upper()


def table(rows: Sequence[Sequence[str]], head: Sequence[str]) -> str:
    """Rows in columns, left-aligned, under a head."""
    lines = [list(head), *[list(row) for row in rows]]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )


def print_json(value: Any) -> None:
    import json

    print(json.dumps(value, ensure_ascii=False))
