"""A computed field reads the fields of its own frame, also if the row of a service has a field of the same name."""

from __future__ import annotations

from pathlib import Path

from framekit.cli.main import main

PROTOCOL = """
protocol: own-first
extends: standard
line: {format: 8E1}
station: {type: none}
groups: {request: {from: client, head: [{const: STX}]}}
frames:
  ASK:  {group: request, body: [{field: unit, type: u8, build: 3 + 4}, {field: twice, type: u8, is: unit}, {field: at, type: u8}]}
  TOLD: {from: server, body: [{const: ACK}, {data: d, size: 2}]}
areas: {D: {unit: word, size: 10}}
addresses: [{form: "D{start:dec}", area: "'D'"}]
services:
  read: [{request: {ASK: {at: start}}, back: {area: "'D'"}, limit: {count: 1}, reply: {TOLD: {d: data}}}]
"""  # noqa: E501
VECTORS = """
vectors: own-first
conversations:
  - {name: r, role: client, do: {read: D1}, script: [{send: 02 07 07 01}, {receive: 06 00 05}], result: {values: [5]}}
  - {name: serve, role: server, memory: {D1: 5}, script: [{receive: 02 07 07 01}, {send: 06 00 05}]}
"""


def test_both_sides(tmp_path: Path) -> None:
    (tmp_path / "own-first.yaml").write_text(PROTOCOL, "utf-8")
    (tmp_path / "own-first.vectors.yaml").write_text(VECTORS, "utf-8")
    assert main(["test", str(tmp_path / "own-first.yaml")]) == 0
