"""Command blocks from a command line: all words of one, those from the command on, or names with values."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from framekit.cli.common import assignment, why_not
from framekit.cli.main import Failure, WrongWords

if TYPE_CHECKING:
    from framekit.blocks.command_words import CommandWords


def commands_in(words: list[str]) -> list[list[str]]:
    """The words of each command, with those of files in place of @FILE; + stands between two. Raises Failure."""
    found: list[list[str]] = [[]]
    for given in words:
        for word in _words_of(given[1:]) if given.startswith("@") else [given]:
            if word == "+":
                found.append([])
            else:
                found[-1].append(word)
    return found


def _words_of(file: str) -> list[str]:
    """The words in a file, in which # begins a remark. Raises Failure."""
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise WrongWords(f"@{file}: there is no such file – check its name and folder") from None
    except OSError as error:
        raise Failure(f"@{why_not(error)}") from None
    except UnicodeDecodeError:
        raise Failure(f"@{file}: this is no text – write words with blanks between them") from None
    return [word for line in lines for word in line.partition("#")[0].replace(",", " ").split()]


def record_of(words: CommandWords, given: list[str]) -> bytes:
    """The command block that is meant: all its words, those from the command on, or a command with named fields.

    Fields of the words before the command may be given beside either. Raises ValueError.
    """
    from framekit.definition.problems import did_you_mean

    plain = [text for text in given if "=" not in text]
    fields = dict(assignment(text) for text in given if "=" in text)
    head = {name: fields.pop(name) for name in list(fields) if name in words.head()}
    if len(plain) == 1 and not plain[0].lstrip("-")[:1].isdigit():
        return _named(words, plain[0], fields, head)
    if fields:
        name = next(iter(fields))
        hint = did_you_mean(name, words.head())
        raise ValueError(
            f"'{name}' is no field beside words – name the command instead of its number"
            + (f"; {hint}" if hint else "")
        )
    if not plain:
        raise ValueError("there are no words – give them, or the name of a command")
    return _numbered(words, plain, head)


def _named(words: CommandWords, name: str, fields: dict[str, object], head: dict[str, object]) -> bytes:
    """A command by its name. Raises ValueError."""
    from framekit.codec.encode_hints import with_hint
    from framekit.codec.errors import EncodeError
    from framekit.definition.problems import did_you_mean

    if name not in words.requests:
        hint = did_you_mean(name, words.requests)
        raise ValueError(f"'{words.application.name}' has no command '{name}'" + (f" – {hint}" if hint else ""))
    try:
        return words.make(name, fields, head)
    except EncodeError as error:
        raise ValueError(f"{name}: {with_hint(error, words.application, name, fields, words.head())}") from None


def _numbered(words: CommandWords, texts: list[str], head: dict[str, object]) -> bytes:
    """A whole block, or the words of one from the command on. Raises ValueError."""
    from framekit.blocks.command_words import CommandFaultError, bytes_of
    from framekit.codec.plain import PlainValues
    from framekit.definition.load.scalars import parse_number

    data = bytes_of([parse_number(text) for text in texts])
    try:
        block = words.read(data)
        is_whole = len(block.raw) == len(data)
    except CommandFaultError:
        is_whole = False
    if is_whole:
        if not head:
            return data
        own = {name: block.block.fields[name] for name in words.head() if name != words.length}
        head, data = {**own, **head}, data[words.head_size :]
    elif not words.is_known(data) and (misfit := words.head_misfit(data)):
        raise ValueError(f"{misfit} – correct the first word, or leave the head out")
    request, values = words.read_request(data)
    return words.make(request, PlainValues(words.application).to_plain(request, values), head)
