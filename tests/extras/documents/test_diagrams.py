"""Diagrams of sequences: they contain exactly the steps and transitions of the sequence."""

from __future__ import annotations

import re

import pytest
import shipped
from spread import spread

from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.extras.documents.diagrams import diagrams, sequence_diagram

ARROW = re.compile(r"    (\S+) --> (\S+?)(?:: .+)?$")


@pytest.mark.parametrize("name", spread(shipped.PROTOCOLS, 4, 2))
def test_every_step_is_a_state_that_can_be_reached_and_left(name: str) -> None:
    for sequence in load_protocol(name).sequences.values():
        lines = sequence_diagram(sequence).splitlines()
        assert lines[0] == "stateDiagram-v2"
        arrows = [match.groups() for line in lines if (match := ARROW.match(line))]
        described = {line.split(":")[0].strip() for line in lines[2:] if "-->" not in line}
        assert {f"step_{step.name}" for step in sequence.steps} <= described
        assert {source for source, _ in arrows} == described | {"[*]"}
        assert {target for _, target in arrows} - {"[*]"} == described


def test_rows_branches_handlers_and_failures() -> None:
    text = """\
protocol: p
frames: {a: {body: [{const: 01}]}, b: {body: [{const: 02}]}}
sequences:
  s:
    steps:
      - {step: ask, send: a, receive: [{frame: b, when: own == 1, then: sort}, {frame: a, then: again}], within: 1 s,
         on_timeout: {then: resend, at_most: 2, else: {fail: no_reply}}}
      - {step: sort, branch: [{when: "own in [1; 2]" , then: ask}, {then: end}]}
roles: {client: {lanes: {main: {exchange: s}}}}
""".replace("[1; 2]", "[1, 2]")
    drawn = sequence_diagram(load_protocol_text(text).sequences["s"]).splitlines()
    assert "    step_ask: ask · send a · receive within 1 s" in drawn
    assert "    step_ask --> step_sort: b [own == 1]" in drawn
    assert "    step_ask --> step_ask: time is up at most 2 times / resend" in drawn
    assert "    step_ask --> failed_no_reply: time is up more often" in drawn
    assert "    step_sort --> step_ask: [own in [1, 2]]" in drawn
    assert "    step_sort --> [*]" in drawn
    assert "    failed_no_reply: fails – no_reply" in drawn


def test_a_page_says_who_runs_what() -> None:
    page = diagrams(load_protocol("ccm"))
    assert "## converse\n\nCalled by normal; called by peer.\n\n```mermaid\nstateDiagram-v2\n" in page
    assert "## slave\n\nRuns by itself in role slave.\n" in page


@pytest.mark.parametrize("name", ["df1", "snp-x", "srtp"])
def test_a_page_has_a_diagram_of_every_sequence(name: str) -> None:
    protocol = load_protocol(name)
    headings = re.findall(r"^## (.*)$", diagrams(protocol), re.MULTILINE)
    assert headings == list(protocol.sequences)
    assert diagrams(protocol).count("```mermaid\nstateDiagram-v2\n") == len(headings)
