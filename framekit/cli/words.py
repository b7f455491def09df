"""The parser of the command line, with our words for what is wrong in it: what was probably meant is said beside it."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

_CHOICE = re.compile(r"invalid choice: '(?P<word>[^']*)' \(choose from (?P<choices>.*)\)")


class Parser(argparse.ArgumentParser):
    """As its base; `verbs` are those that it has, by name."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.verbs: dict[str, Parser] = {}

    def error(self, message: str) -> NoReturn:
        """Tells what is wrong and ends with status 2."""
        match = _CHOICE.search(message)
        if match is not None:
            near = _near(match["word"], re.findall(r"[^\s',]+", match["choices"]))
            message += f" – {near}" if near else ""
        super().error(message)

    def refuse(self, unknown: Sequence[str]) -> NoReturn:
        """Tells that these words have no place here."""
        options = [word.partition("=")[0] for word in unknown if len(word) > 1 and word.startswith("-")]
        if not options:
            self.error(f"nothing takes {', '.join(repr(word) for word in unknown)}")
        known = [option for action in self._actions for option in action.option_strings]
        told = []
        for option in options:
            near = _near(option, known)
            told.append(f"there is no option '{option}'" + (f" – {near}" if near else ""))
        self.error("; ".join(told))


def _near(word: str, known: Sequence[str]) -> str:
    from framekit.definition.problems import did_you_mean

    hint = did_you_mean(word, known)
    return hint if hint.startswith("did you mean") else ""
