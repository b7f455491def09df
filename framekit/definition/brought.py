"""Modules that bring kinds of segments, types, check methods, triggers or step keys of their own.

A program imports them; those of installed packages, entry points of the group `framekit.extensions`, are imported when
the first definition of a process is read.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

ENTRY_POINTS = "framekit.extensions"

MODULES: list[ModuleType] = []

_WORDS: dict[tuple[str, str], str] = {}
"""What each word is called, and the word → the module that has brought it."""


def bring(name: str) -> ModuleType:
    """The module of that name, noted as one that has a part in what definitions mean."""
    module = sys.modules[name]
    MODULES[:] = [one for one in MODULES if one is module or one.__name__ != name]
    if module not in MODULES:
        MODULES.append(module)
    return module


def module_of_function(function: Callable[..., Any]) -> str:
    """The name of the module that a function stands in. Raises ValueError where it has no name of its own there."""
    module = sys.modules.get(function.__module__)
    if module is None or vars(module).get(function.__name__) is not function:
        what = f"'{function.__qualname__}' is no function that the module '{function.__module__}' knows by that name"
        raise ValueError(f"{what} – define it there, outside of functions and classes")
    return module.__name__


def bring_word(what: str, word: str, name: str, there: bool) -> None:
    """Notes that the module of that name brings a word; `there`: the word is known already.

    A module that brings it again, as when it is loaded again, replaces it. Raises ValueError for a word of another one.
    """
    owner = _WORDS.get((what, word))
    if owner != name and (there or owner is not None):
        whose = "framekit" if owner is None else f"the module '{owner}'"
        raise ValueError(f"{whose} has the {what} '{word}' already: '{name}' can't bring it too – take another word")
    _WORDS[what, word] = name


def states() -> list[str]:
    """Size and time of every such module's file: what was kept before one of them changed counts no more."""
    found = []
    for module in MODULES:
        file = getattr(module, "__file__", None)
        state = None if file is None or not os.path.exists(file) else os.stat(file)
        found.append(f"{module.__name__} {file} {state and (state.st_size, state.st_mtime_ns)}")
    return found


@cache
def import_installed() -> tuple[str, ...]:
    """Imports the modules that installed packages name; what is wrong with those that cannot be used."""
    from importlib.metadata import entry_points
    from traceback import format_exception_only

    wrong = []
    for point in entry_points(group=ENTRY_POINTS):
        try:
            point.load()
        except Exception as error:  # another package's code: whatever is wrong there is told, and framekit goes on
            why = format_exception_only(error)[-1].strip()
            wrong.append(f"the extension '{point.name}' of {point.value} can't be used: {why}")
    return tuple(wrong)
