"""Positions in definition files, and problems at these positions.

Every complaint about a definition or a run file is a `Problem`; all of them are raised together in a
`DefinitionError`. This module knows neither YAML nor schemas nor the language of definitions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple


class Position(NamedTuple):
    """A place in a file; line and column count from 1. With line 0, `file` is no file but a source's own name."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


NOWHERE = Position("<built-in>", 1, 1)
MOST_PROBLEMS = 100
"""Problems of one load that are reported; the others are counted."""
MOST_EQUAL = 2
"""Equal faults of a file that are reported separately; more are reported together."""
MOST_PLACES = 8
"""Other places that the problem of several places names; further ones are counted."""
LONGEST_SENTENCE = 1_000
"""Characters of an error or a remedy that are printed."""


class Problem(NamedTuple):
    """A fault in a file, and its remedy. Warnings do not stop anything."""

    at: Position
    what: str
    todo: str = ""
    warning: bool = False
    also: tuple[Position, ...] = ()
    """Other places in the same file with the same fault."""

    def __str__(self) -> str:
        kind = "warning: " if self.warning else ""
        todo = f" – {_shortened(self.todo)}" if self.todo else ""
        return printable(f"{self.at}: {kind}{_shortened(self.what)}{_places(self.also)}{todo}")

    @property
    def places(self) -> tuple[Position, ...]:
        """Return all places with this fault."""
        return (self.at, *self.also)


def _shortened(sentence: str) -> str:
    """Return a sentence that quotes a long text of a file with its beginning and its end only."""
    half = LONGEST_SENTENCE // 2
    return sentence if len(sentence) <= LONGEST_SENTENCE else f"{sentence[:half]} … {sentence[-half:]}"


def _places(also: tuple[Position, ...]) -> str:
    """Return the count of a fault and its other places."""
    shown = [f"{place.line}:{place.column}" for place in also[:MOST_PLACES]]
    if len(also) > MOST_PLACES:
        shown.append(plural(len(also) - MOST_PLACES, "other place"))
    return f", {len(also) + 1} times: also at {listed(shown)}" if also else ""


def together(problems: Iterable[Problem]) -> list[Problem]:
    """Return the problems with more than `MOST_EQUAL` equal faults of a file as the problem of several places."""
    equal: dict[tuple[object, ...], list[Problem]] = {}
    for problem in problems:
        kind = (problem.at.file, problem.what, problem.todo, problem.warning, bool(problem.also), problem.at.line > 0)
        equal.setdefault(kind, []).append(problem)
    found: list[Problem] = []
    for same in equal.values():
        first, *others = same
        is_long = len(others) >= MOST_EQUAL and first.at.line > 0
        found += [first._replace(also=tuple(place for one in others for place in one.places))] if is_long else same
    return found


def separately(problems: Iterable[Problem]) -> Iterator[Problem]:
    """Yield each problem at each of its places, for programs; of many equal places the first ones."""
    for problem in problems:
        for place in problem.places[: MOST_PLACES + 1]:
            yield problem._replace(at=place, also=())


def most_important(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Return the problems sorted, each once, equal ones together: `MOST_PROBLEMS` at most, errors before warnings.

    The last problem of a longer list counts the others.
    """
    found = sorted(together(sorted(set(problems))))
    if len(found) <= MOST_PROBLEMS:
        return tuple(found)
    first = sorted(found, key=_is_warning)[:MOST_PROBLEMS]
    others = len(found) - MOST_PROBLEMS
    is_warning = found[0].warning and all(problem.warning for problem in found)
    counted = Problem(first[-1].at, f"{others} more problems are not shown", "correct the others first", is_warning)
    return (*sorted(first), counted)


def _is_warning(problem: Problem) -> bool:
    return problem.warning


class DefinitionError(ValueError):
    """A definition that cannot be used; `problems` are sorted by position (`most_important`)."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = most_important(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class CannotSayError(Exception):
    """A part of a definition that a generator cannot express in its language, with its place and a remedy or reason."""

    def __init__(self, at: Position, what: str, todo: str = "") -> None:
        super().__init__(what)
        self.problem = Problem(at, what, todo)


def without_library(what: str, library: str) -> tuple[str, str]:
    """Return problem and remedy for a library that is missing for `what`."""
    return f"{what} needs the library {library}, which is not installed", f"install it: pip install {library}"


def library_missing(what: str, library: str) -> str:
    """Return both joined to a sentence."""
    return " – ".join(without_library(what, library))


def printable(text: str) -> str:
    """Return the text on one line: characters that are not printable, line ends among them, as `repr` writes them."""
    return text if text.isprintable() else "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def visible(text: str) -> str:
    """Return the text with its invisible characters as escapes; line ends, tabs and other spaces remain.

    Invisible are control characters, bidirectional marks, characters of no width and lone surrogates.
    """
    return text if text.isprintable() else "".join(map(_visible_sign, text))


def _visible_sign(sign: str) -> str:
    from unicodedata import category

    is_visible = sign.isprintable() or sign in "\n\t" or category(sign) == "Zs"
    return sign if is_visible else repr(sign)[1:-1]


_WITHOUT_TEXT: tuple[tuple[type[BaseException], str], ...] = (
    (TimeoutError, "no answer within the time limit"),
    (ConnectionResetError, "the other side has reset the connection"),
    (ConnectionRefusedError, "the other side refuses the connection"),
    (BrokenPipeError, "the other side has closed the connection"),
    (ConnectionError, "the connection was lost"),
    (EOFError, "the other side has closed the connection"),
    (MemoryError, "not enough memory"),
)
"""Sentences for errors whose libraries give no text."""
_NAMED = (LookupError, TypeError, AttributeError, AssertionError, NameError, ArithmeticError)
"""Errors whose texts say little without the kind of the error: `KeyError: 'level'`."""


def error_text(error: BaseException) -> str:
    """Return the cause of an error of the system or of a library, as one line for users; it is never empty.

    An error without a text has the cause of the error that it followed, or a sentence for its kind.
    """
    of_system = error.strerror if isinstance(error, OSError) else ""  # libraries put anything there
    text = " ".join(((of_system if isinstance(of_system, str) else "") or str(error)).split())
    if text:
        return f"{type(error).__name__}: {text}" if isinstance(error, _NAMED) else text
    earlier = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    if earlier is not None and earlier is not error and str(earlier).strip():
        return error_text(earlier)
    sentence = next((words for kind, words in _WITHOUT_TEXT if isinstance(error, kind)), "")
    return sentence or f"an error of the kind {type(error).__name__}, without a text"


def plural(number: int, noun: str) -> str:
    """Return the number with its noun: `1 byte`, `2 bytes`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listed(things: Iterable[object]) -> str:
    """Return `a, b and c`; the list is not empty."""
    *some, last = map(str, things)
    return f"{', '.join(some)} and {last}" if some else last


def is_nearly(word: str, other: str) -> bool:
    """Return whether the other word is probably a misspelling of this word."""
    import difflib  # with the first misspelt word

    return other not in (word, word + "s") and bool(difflib.get_close_matches(other, [word], cutoff=0.75))


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a hint with the known words nearest to `word`, or with all of them if they are few, or ''."""
    import difflib

    words = sorted(set(known))
    near = difflib.get_close_matches(word, words, n=2, cutoff=0.5 if len(word) <= 3 else 0.6)
    if near:
        return "did you mean " + " or ".join(f"'{name}'" for name in near) + "?"
    if 0 < len(words) <= 8:
        return "known: " + ", ".join(words)
    return ""


def no_such(what: str, name: str, known: Iterable[str]) -> str:
    """Return `what 'name'` and, after a dash, a hint at the known names."""
    hint = did_you_mean(name, known)
    return f"{what} '{name}'" + (f" – {hint}" if hint else "")


def parted(error: Exception) -> tuple[str, str]:
    """Return problem and remedy of an error whose text has them before and after a dash."""
    what, _, todo = str(error).partition(" – ")
    return what, todo
