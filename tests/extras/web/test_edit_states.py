"""State diagrams of the editor: every step and transition is drawn, and no text is markup."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from extras.web.edit_world import LAMP, answer_of, written

from framekit.api.codec import load
from framekit.definition.sources import shipped_definitions
from framekit.extras.documents.diagrams import Arrow, ArrowEnd, DiagramState, sequence_states
from framekit.extras.web.edit_states import MOST_STATES, states_svg

SVG = "{http://www.w3.org/2000/svg}"


def drawn(states: tuple[DiagramState, ...], title: str = "a") -> ElementTree.Element:
    return ElementTree.fromstring(states_svg(title, states))


def texts(picture: ElementTree.Element, look: str) -> list[str]:
    return [
        (element.text or element[0].tail or "")
        for element in picture.iter(f"{SVG}text")
        if element.get("class") == look
    ]


def test_states_of_a_shipped_sequence() -> None:
    states = sequence_states(load("modbus-rtu").definition.sequences["exchange"])
    picture = drawn(states)
    assert texts(picture, "name") == ["everybody", "ask", "pause"]
    assert texts(picture, "fails") == ["fails: no_reply"]
    assert texts(picture, "target") == ["ask", "pause", "↻ again", "↻ again", "↻ again"]
    assert len([element for element in picture.iter(f"{SVG}g") if element.get("class") == "to"]) == 2


def test_vertical_lines_that_pass_each_other_have_places_of_their_own() -> None:
    steps = [f"s{number}" for number in range(8)]
    states = tuple(
        DiagramState(name, name, tuple(Arrow("", ArrowEnd("step", other)) for other in steps if other != name))
        for name in steps
    )
    paths = [element.get("d") or "" for element in drawn(states).iter(f"{SVG}path") if element.get("class") == "line"][
        1:
    ]
    across = [path.split("H")[1].partition("M")[0] for path in paths]
    assert len(set(across)) == len(steps)


def test_names_are_texts_and_long_ones_are_cut() -> None:
    name = '<script>"x"</script>&\u202e'
    picture = drawn(
        (DiagramState(name, f"{name} · send {'x' * 500}", (Arrow("y" * 500, ArrowEnd("failed", name)),)),), name
    )
    assert not list(picture.iter(f"{SVG}script"))
    assert all(len(text) <= 80 for text in texts(picture, "does") + texts(picture, "event"))
    (event,) = (element for element in picture.iter(f"{SVG}text") if element.get("class") == "event")
    assert event[0].text == "y" * 500


def test_a_long_sequence_is_drawn_in_part() -> None:
    states = tuple(
        DiagramState(f"s{n}", f"s{n}", (Arrow("", ArrowEnd("step", f"s{n + 1}")),)) for n in range(MOST_STATES + 50)
    )
    picture = drawn(states)
    assert len(texts(picture, "name")) == MOST_STATES
    assert texts(picture, "target")[-1] == f"s{MOST_STATES} …"


def test_every_shipped_sequence_is_drawn() -> None:
    drawings = 0
    for path in shipped_definitions()[::6]:
        if "." in path.stem:
            continue
        for sequence in load(path).definition.sequences.values():
            assert len(texts(drawn(sequence_states(sequence)), "name")) == len(sequence.steps)
            drawings += 1
    assert drawings > 5


def test_the_page_gets_the_pictures(tmp_path: Path) -> None:
    text = LAMP + "sequences:\n  ask:\n    steps:\n      - {step: first, send: {SWITCH: {station: 1, level: 2}}}\n"
    found = answer_of("look", written(tmp_path, text))
    ((name, svg),) = found["protocols"][0]["sequences"]
    assert name == "ask" and ElementTree.fromstring(svg).get("class") == "states"
