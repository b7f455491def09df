"""Extensions: modules with kinds of segments, types, check methods, triggers or step keys of their own.

A program imports them itself; extensions of installed packages, entry points of the group `framekit.extensions`, are
imported with the first definition that a process reads.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import cache
from types import ModuleType
from typing import Any

from framekit.definition.installed import entry_points_of

ENTRY_POINTS = "framekit.extensions"

MODULES: list[ModuleType] = []

_WORDS: dict[tuple[str, str], str] = {}
"""The module of each word, by the kind of the word and the word."""


def bring(name: str) -> ModuleType:
    """Note a module as an extension, which changes the meaning of definitions, and return it."""
    module = sys.modules[name]
    MODULES[:] = [one for one in MODULES if one is module or one.__name__ != name]
    if module not in MODULES:
        MODULES.append(module)
    return module


def module_of_function(function: Callable[..., Any]) -> str:
    """Return the name of the module that defines a function. Raises ValueError if the module lacks it."""
    module = sys.modules.get(function.__module__)
    if module is None or vars(module).get(function.__name__) is not function:
        what = f"'{function.__qualname__}' is no function that the module '{function.__module__}' knows by that name"
        raise ValueError(f"{what} – define it there, outside of functions and classes")
    return module.__name__


def bring_word(what: str, word: str, name: str, there: bool) -> None:
    """Note that a module defines a word; `there`: the word exists already.

    A module that defines it again, as when it is reloaded, replaces it. Raises ValueError for a word of another module.
    """
    owner = _WORDS.get((what, word))
    if owner != name and (there or owner is not None):
        whose = "framekit" if owner is None else f"the module '{owner}'"
        raise ValueError(f"{whose} has the {what} '{word}' already: '{name}' can't bring it too – take another word")
    _WORDS[what, word] = name


def states() -> list[str]:
    """Return size and time of each extension's file: entries of the cache do not count after a change."""
    found = []
    for module in MODULES:
        file = getattr(module, "__file__", None)
        state = None if file is None or not os.path.exists(file) else os.stat(file)
        found.append(f"{module.__name__} {file} {state and (state.st_size, state.st_mtime_ns)}")
    return found


@cache
def import_installed() -> tuple[str, ...]:
    """Import the extensions of installed packages; return messages about those that fail."""
    wrong = []
    for point in entry_points_of(ENTRY_POINTS):
        try:
            point.load()
        except Exception as error:  # another package's code: any error there is reported, and framekit goes on
            from traceback import format_exception_only

            why = format_exception_only(error)[-1].strip()
            wrong.append(f"the extension '{point.name}' of {point.value} can't be used: {why}")
    return tuple(wrong)
