"""Procedures: services whose sequence calls other services, with arguments, results and conditional names for codes."""

from __future__ import annotations

from typing import Any

import pytest
from link.link_world import SECOND, Side, compiled, load

from framekit.definition.problems import DefinitionError
from framekit.link.services.client import ServiceClient, ServiceError, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

CELLS = """
protocol: cells
extends: standard
params:
  kind: {type: choice, of: [plain, odd], default: plain}
  steps: {type: number, default: 1}
  twice: {type: number, is: steps * 2}
  offset: {type: number, is: twice - 2}
groups:
  request: {from: client, head: [{const: STX}]}
  reply: {from: server, head: [{const: ACK}]}
frames:
  get:  {group: request, body: [{const: 01}, {field: cell, type: u8}]}
  set:  {group: request, body: [{const: 02}, {field: cell, type: u8}, {field: value, type: u8}]}
  cell: {group: reply, body: [{const: 01}, {field: value, type: u8}]}
  kept: {group: reply, body: [{const: 02}]}
  "no": {group: reply, body: [{const: 0F}, {field: code, type: u8}]}
tables:
  reasons: {1: no such cell, 2: cannot be set}
  odd_reasons: {1: no such hole}
  get_reasons: {1: nothing to get there}
state:
  cells: {scope: device, table: 0..9, holds: u8}
sequences:
  swap:
    takes: [one, two, station]
    gives: {before: first, moved: moved}
    local: {first: number, second: number, moved: number}
    steps:
      - {step: one, ask: {fetch: {cell: one}}, into: {first: value}}
      - {step: two, ask: {fetch: {cell: two}}, into: {second: value}}
      - {step: three, ask: {keep: {cell: one, value: second}}, set: {moved: 1}}
      - {step: four, ask: {keep: {cell: two, value: first}}, set: {moved: 2}}
  far:
    takes: [place, station]
    gives: {found: found, there: offset}
    local: {found: number}
    steps:
      - {step: one, ask: {fetch_at: {cell: place}}, into: {found: value}}
roles:
  client: {lanes: {main: {exchange: [exchange, swap, far]}}}
errors:
  frame: "no"
  code: code
  names: [{table: odd_reasons, when: kind == 'odd'}, {table: get_reasons, when: request.frame == 'get'}, reasons]
  answer: {"no": {code: code}}
  memory: {no_service: 9}
services:
  fetch:
    - takes: {cell: {type: number}}
      request: {get: {cell: cell}}
      gives: {value: reply.value}
      refuse: [{when: request.cell not in cells, code: 1}]
      reply: {cell: {value: "cells[request.cell]"}}
  keep:
    - takes: {cell: {type: number}, value: {type: number}}
      request: {set: {cell: cell, value: value}}
      refuse: [{when: request.cell > 9, code: 1}, {when: request.value == 0, code: 2}]
      serve: {set: {"cells[request.cell]": request.value}}
      reply: {kept: {}}
  fetch_at:
    - takes: {cell: {type: number}}
      request: {get: {cell: cell + offset}}
      client_only: yes
      reply: {cell: {value: 0}}
      gives: {value: reply.value, steps: twice}
  far:
    - takes: {place: {type: number}}
      run: far
      client_only: yes
      gives: {value: found, offset: there}
  swap:
    - takes: {one: {type: number}, two: {type: number, default: 1}}
      run: swap
      client_only: yes
      gives: {before: before, steps: moved}
"""


class Pair:
    """A client, and a device that stores cells."""

    def __init__(self, text: str = CELLS) -> None:
        protocol, codec = compiled(text)
        memory = DeviceMemory(memory_of(protocol)[0])
        self.device = Side(text, "server", own=1, server=MemoryServer(protocol, codec, memory))
        self.asking = Side(text, "client", ask=lambda *arguments: self.client.ask(*arguments))
        self.client = ServiceClient(protocol, codec, self.asking.engine)

    @property
    def cells(self) -> Any:
        return self.device.engine.scope["cells"]

    def call(self, service: str, **arguments: Any) -> TransferResult:
        params = arguments.pop("params", None)
        results: list[TransferResult] = []
        self.asking.do(
            self.client.call(
                service, arguments, station=1, params=params, now=self.asking.now, on_done=results.append
            ).commands
        )
        end = self.asking.now + 20 * SECOND
        while not results and self.asking.now < end:
            for side, peer in ((self.asking, self.device), (self.device, self.asking)):
                for data in side.taken():
                    peer.do(peer.engine.receive(data, peer.now))
            at = min(end, self.asking.next_time(), self.device.next_time())
            for side in (self.asking, self.device):
                side.run(at - side.now)
        assert len(results) == 1
        return results[0]


def test_a_procedure_takes_arguments_asks_services_and_gives_results() -> None:
    pair = Pair()
    assert pair.call("keep", cell=1, value=11).ok and pair.call("keep", cell=4, value=44).ok
    result = pair.call("swap", one=4)
    assert (result.ok, result.gives) == (True, {"before": 44, "steps": 2})
    assert dict(pair.cells) == {1: 44, 4: 11}


def test_a_refusal_in_the_middle_ends_the_procedure_with_its_meaning() -> None:
    pair = Pair()
    pair.call("keep", cell=1, value=11)
    result = pair.call("swap", one=1, two=7)
    assert (result.ok, result.outcome, result.cause) == (False, "refused", "nothing to get there")
    assert dict(pair.cells) == {1: 11}


def test_names_of_codes_follow_their_conditions() -> None:
    pair = Pair()
    assert pair.call("fetch", cell=3).meaning == "nothing to get there"
    assert pair.call("keep", cell=30, value=1).meaning == "no such cell"
    assert pair.call("keep", cell=3, value=0).meaning == "cannot be set"


def test_params_of_a_call_hold_for_what_its_sequence_asks() -> None:
    pair = Pair()
    assert pair.call("fetch", cell=3, params={"kind": "odd"}).meaning == "no such hole"
    assert pair.call("swap", one=3, params={"kind": "odd"}).cause == "no such hole"


def test_parameters_that_are_formulas_see_those_of_the_call() -> None:
    pair = Pair()
    pair.call("keep", cell=1, value=11)
    pair.call("keep", cell=7, value=77)
    assert pair.call("fetch_at", cell=1).gives == {"value": 11, "steps": 2}
    assert pair.call("fetch_at", cell=1, params={"steps": 4}).gives == {"value": 77, "steps": 8}
    assert pair.call("far", place=1, params={"steps": 4}).gives == {"value": 77, "offset": 6}
    assert pair.call("far", place=1).gives == {"value": 11, "offset": 0}


def test_a_formula_that_has_a_value_of_its_own_keeps_it() -> None:
    scope = Pair().asking.engine.scope
    assert set(scope.formulas_for(["steps"]) or ()) == {"twice", "offset"}
    assert set(scope.formulas_for(["steps", "twice"]) or ()) == {"offset"}
    assert scope.formulas_for(["kind"]) is None
    dict.__setitem__(scope, "offset", 5)
    assert set(scope.formulas_for(["steps"]) or ()) == {"twice"}


def test_arguments_are_checked_as_for_every_service() -> None:
    pair = Pair()
    with pytest.raises(ServiceError, match="needs the argument 'one'"):
        pair.call("swap", two=2)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("into: {first: value}", "into: {first: worth}", "'fetch' gives no 'worth'"),
        ("into: {first: value}", "into: {frist: value}", "there is no variable 'frist' to set"),
        ("takes: [one, two, station]", "takes: [one, two, three]", "an exchange has no 'three' for 'swap'"),
        ("gives: {before: before, steps", "gives: {before: befor, steps", "there is no name 'befor' here"),
        ("set: {moved: 1}}", "then: next, into: {first: value}}", "'keep' gives no 'value'"),
        ("ask: {keep: {cell: two, value: first}}, set", "into: {first: value}, set", "nothing here has results"),
        ("{table: odd_reasons, when", "{table: even_reasons, when", "there is no table 'even_reasons'"),
    ],
)
def test_what_does_not_fit_is_told(old: str, new: str, problem: str) -> None:
    assert old in CELLS
    with pytest.raises(DefinitionError, match=problem):
        load(CELLS.replace(old, new))
