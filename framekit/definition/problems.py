"""Positions in definition files and the problems found there.

Every complaint about a definition or a run file is a `Problem`; they are collected and raised together as one
`DefinitionError`. Nothing here knows YAML, schemas or what a definition means.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, order=True)
class Position:
    """A place in a file; line and column count from 1. With line 0 `file` is not a file but words by themselves."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


NOWHERE = Position("<built-in>", 1, 1)


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """One thing wrong in a file: what it is, and what to do about it. A warning does not stop anything."""

    at: Position
    what: str
    todo: str = ""
    warning: bool = False

    def __str__(self) -> str:
        kind = "warning: " if self.warning else ""
        return printable(f"{self.at}: {kind}{self.what}" + (f" – {self.todo}" if self.todo else ""))


class DefinitionError(ValueError):
    """A definition that cannot be used; `problems` holds all of them, sorted by position."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))


class CannotSayError(Exception):
    """What has no form in the language that a generator writes: what it is and where it stands, what to do or why."""

    def __init__(self, at: Position, what: str, todo: str = "") -> None:
        super().__init__(what)
        self.problem = Problem(at, what, todo)


def without_library(what: str, library: str) -> tuple[str, str]:
    """What is wrong, and what to do, where a library is not installed that `what` needs."""
    return f"{what} needs the library {library}, which is not installed", f"install it: pip install {library}"


def library_missing(what: str, library: str) -> str:
    """The same as one sentence."""
    return " – ".join(without_library(what, library))


def printable(text: str) -> str:
    """The text on one line: signs that are not shown, line ends among them, as `repr` writes them."""
    return text if text.isprintable() else "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def plural(number: int, noun: str) -> str:
    """`1 byte`, `2 bytes`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listed(things: Iterable[object]) -> str:
    """`a, b and c`; there is at least one."""
    *some, last = map(str, things)
    return f"{', '.join(some)} and {last}" if some else last


def is_nearly(word: str, other: str) -> bool:
    """Whether the other word is probably this one misspelt."""
    return other not in (word, word + "s") and bool(difflib.get_close_matches(other, [word], cutoff=0.75))


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """A hint naming the known words nearest to `word`, or all of them when they are few, or ''."""
    words = sorted(set(known))
    near = difflib.get_close_matches(word, words, n=2, cutoff=0.5 if len(word) <= 3 else 0.6)
    if near:
        return "did you mean " + " or ".join(f"'{name}'" for name in near) + "?"
    if 0 < len(words) <= 8:
        return "known: " + ", ".join(words)
    return ""


def no_such(what: str, name: str, known: Iterable[str]) -> str:
    """`what 'name'` and, behind a dash, what could be meant: for a name that there is not."""
    hint = did_you_mean(name, known)
    return f"{what} '{name}'" + (f" – {hint}" if hint else "")


def parted(error: Exception) -> tuple[str, str]:
    """What is wrong, and behind a dash what to do, of an error whose text is such a sentence."""
    what, _, todo = str(error).partition(" – ")
    return what, todo
