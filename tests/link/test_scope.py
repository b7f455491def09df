"""Temporary values of parameters: restored in any order, and unchanged if one of the new values is invalid."""

from __future__ import annotations

import pytest

from framekit.definition.load.protocol import load_protocol
from framekit.link.scope import Scope
from framekit.link.variables import ParameterError


@pytest.fixture
def scope() -> Scope:
    return Scope(load_protocol("modbus-rtu"), role="client")


def test_what_is_given_for_a_while_is_given_back_in_any_order(scope: Scope) -> None:
    first = scope.override({"retries": 5, "reply_timeout": "2 s"})
    second = scope.override({"retries": 6})
    assert scope["retries"] == 6
    first()
    assert (scope["retries"], scope["reply_timeout"]) == (6, 1_000_000_000)
    second()
    assert scope["retries"] == 2


def test_the_one_before_counts_again(scope: Scope) -> None:
    scope.set("retries", 3)
    first = scope.override({"retries": 5})
    scope.override({"retries": 6})()
    assert scope["retries"] == 5
    first()
    assert scope["retries"] == 3


def test_one_wrong_value_changes_none_of_them(scope: Scope) -> None:
    with pytest.raises(ParameterError):
        scope.override({"retries": 5, "reply_timeout": "soon"})
    assert scope["retries"] == 2
