"""The texts made from the shipped protocols equal the stored texts (README.md explains how to store a change)."""

from __future__ import annotations

import pytest
from golden import kept
from golden.frozen import NAMES, Shipped, cases
from spread import spread

HOW = "see `python -m tests.golden --diff HEAD`; if that is what is wanted, `python -m tests.golden --write`"


@pytest.mark.parametrize("name", spread(NAMES, 3))
def test_nothing_has_changed(name: str) -> None:
    assert kept.differences(name, (case for case in cases(Shipped(name)) if case.quick)) == [], HOW


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_nothing_else_has_changed(name: str) -> None:
    every = list(cases(Shipped(name)))
    assert kept.differences(name, (case for case in every if not case.quick)) == [], HOW
    assert kept.read(name).keys() <= {case.name for case in every}, "cases that are gone: --write forgets them"
