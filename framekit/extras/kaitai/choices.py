"""Combine the cases of a choice in a Kaitai Struct file: the choice as a segment, and the meaning of its name.

All cases of a choice share one name. Expressions can read a name inside it that has the same meaning in every case, or
in every case of one type; other names have no meaning outside of their case.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from framekit.definition.expression import ATOM
from framekit.extras.kaitai.attributes import Keys, KsyPart
from framekit.extras.kaitai.translation import UNKNOWN, KsyMeaning, KsyScope, Translated, quoted

_CASE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def entry_of_cases(name: str, entries: list[tuple[str, KsyMeaning]], always: bool) -> KsyMeaning:
    """Return the meaning of a choice's name: a record of one of several types, or values of one kind.

    `always`: one of the cases is always present.
    """
    kinds = {entry.kind for _, entry in entries}
    if kinds == {"record"} or (kinds == {"record", "bytes"}):
        scopes: dict[str, KsyScope] = {}
        for type_, entry in entries:
            if entry.scope is not None and type_ in scopes:
                _lose_what_differs(scopes[type_], entry.scope)
            elif entry.scope is not None:
                scopes[type_] = entry.scope
        return KsyMeaning(name, "choice", cases=scopes)
    if len(kinds) == 1 and kinds <= {"int", "str", "bytes"}:
        spans = [entry.span for _, entry in entries if entry.span is not None]
        span = (min(one[0] for one in spans), max(one[1] for one in spans)) if spans else None
        return KsyMeaning(name, next(iter(kinds)), span, when="" if always else UNKNOWN)
    return KsyMeaning("", "lost", why="which may be of several kinds")


def _lose_what_differs(one: KsyScope, other: KsyScope) -> None:
    """Remove the names of a type in two cases whose meanings differ, such as parameters."""
    for name, here in [*one.entries.items()]:
        there = other.entries.get(name)
        if there is None or _said(here) != _said(there):
            one.entries[name] = KsyMeaning("", "lost", why="which is another one in each case")
            continue
        inside = [(here.scope, there.scope), *((scope, there.cases.get(type_)) for type_, scope in here.cases.items())]
        for scope, its in inside:
            if scope is not None and its is not None and scope is not its:
                _lose_what_differs(scope, its)


def _said(entry: KsyMeaning) -> tuple[object, ...]:
    """Return a meaning without its inner scopes."""
    return replace(entry, scope=None, cases={}), entry.scope is None, tuple(entry.cases)


def choose(on: Translated, cases: Mapping[int | str, KsyPart], otherwise: KsyPart) -> Keys:
    """Return a choice as a segment; if a case key would not be read as text, all keys are numbered."""
    if all(isinstance(key, int) or _CASE.fullmatch(key) for key in cases):
        segment: Keys = {"choose": on.text, "cases": {key: part.segments for key, part in cases.items()}}
    else:
        text = "0"
        for number, key in reversed([*enumerate(cases, 1)]):
            text = f"{number} if {on.at_level(ATOM)} == {quoted(str(key))} else {text}"
        segment = {"choose": text, "cases": {number: part.segments for number, part in enumerate(cases.values(), 1)}}
    if not cases:
        segment["cases"] = {0: otherwise.segments}
    return {**segment, "else": otherwise.segments}
