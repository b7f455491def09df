"""Scope of the names of command blocks on a channel: owners of variables, and sessions that end for both sides."""

from __future__ import annotations

import gc

import pytest
from link.link_world import load

from framekit.link.scope import CommandScope, Scope

LINE = """
protocol: line
params: {pause: {type: time, default: 1 s}}
state:
  level: {scope: session, type: u8, initial: 1}
frames:
  one: {body: [{const: 01}]}
"""
ORDERS = """
application: orders
params: {pause: {type: time, default: 1 s}}
state:
  level:  {scope: session, type: u8, initial: 9}
  orders: {scope: session, type: u8, initial: 5}
  days:   {scope: device, type: u8}
  kept:   {type: u8}
frames:
  order: {body: [{const: 01}]}
"""


@pytest.fixture
def channel() -> Scope:
    return Scope(load(LINE))


def test_a_name_that_the_channel_has_is_the_channels(channel: Scope) -> None:
    commands = CommandScope(load(ORDERS), channel)
    assert (commands["level"], commands["orders"]) == (1, 5)
    commands.set("level", 4)
    commands.set("pause", 7)
    assert (channel["level"], channel["pause"]) == (4, 7) and "orders" not in channel.protocol.state


def test_sessions_end_for_the_commands_too(channel: Scope) -> None:
    commands = [CommandScope(load(ORDERS), channel) for _ in range(2)]
    for scope in commands:
        scope.set("orders", 6)
        scope.set("days", 3)
        scope.set("kept", 8)
    channel.set("level", 4)
    channel.reset_session()
    for scope in commands:
        assert (scope["level"], scope["orders"], scope["days"], scope["kept"]) == (1, 5, 3, 8)
    channel.set("level", 4)
    commands[0].reset_session()
    assert (commands[0]["level"], channel["level"]) == (4, 4), "what is the channel's ends with the channel's session"


@pytest.mark.usefixtures("small_heap")
def test_commands_that_nobody_has_any_more_are_forgotten(channel: Scope) -> None:
    CommandScope(load(ORDERS), channel)
    gc.collect()
    channel.reset_session()
    assert channel.followers == []
