"""Parameters that one exchange gives other values: its names alone have them, and a wrong value is refused."""

from __future__ import annotations

import pytest

from framekit.definition.load import load_protocol
from framekit.link.scope import Scope
from framekit.link.variables import ParameterError


@pytest.fixture
def scope() -> Scope:
    return Scope(load_protocol("modbus-rtu"), role="client")


def test_names_of_an_exchange_leave_those_of_the_line_as_they_are(scope: Scope) -> None:
    names = scope.names_for({"retries": "5", "reply_timeout": "2 s"})
    assert (names["retries"], names["reply_timeout"]) == (5, 2_000_000_000)
    assert (scope["retries"], scope["reply_timeout"]) == (2, 1_000_000_000)
    assert names["role"] == "client"


def test_what_the_line_sets_meanwhile_is_seen_where_nothing_else_was_given(scope: Scope) -> None:
    names = scope.names_for({"retries": 5})
    scope.set("retries", 3)
    scope.set("reply_timeout", 3_000_000_000)
    assert (names["retries"], names["reply_timeout"]) == (5, 3_000_000_000)


@pytest.mark.parametrize("given", [{"retries": 5, "reply_timeout": "soon"}, {"retrys": 5}])
def test_a_wrong_value_or_name_is_refused(scope: Scope, given: dict[str, object]) -> None:
    with pytest.raises(ParameterError):
        scope.names_for(given)


@pytest.mark.parametrize(
    ("given", "may_change"),
    [
        ({"reply_timeout": "2 s"}, False),
        ({"reply_timeout": "9 chars"}, False),
        ({"reply_timeout": "9 chars + now"}, True),
    ],
)
def test_times_of_the_line_do_not_change(scope: Scope, given: dict[str, object], may_change: bool) -> None:
    assert scope.may_change(given) is may_change
