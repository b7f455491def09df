"""State diagrams of sequences as SVG: a box for each step, a row for each transition, a line to the step it leads to.

Steps stand below each other in their order. The lines to a step share one vertical line, so that they never need a
layout by trial. Colours are classes of the page's style sheet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from framekit.extras.documents.diagrams import Arrow, DiagramState

MOST_STATES = 120
"""Largest number of steps that are drawn."""
_WIDTH, _HEAD, _ROW, _GAP = 440, 28, 20, 18
"""Width of a box; heights of its head and of a row; space between two boxes (pixels)."""
_LANE = 11
"""Distance of two vertical lines (pixels)."""
_LETTER = 6.4
"""Width of a character (pixels), on average."""
_ROOM = 24


@dataclass(slots=True)
class _Box:
    """A step with its place: `top` is the upper edge."""

    state: DiagramState
    top: int

    @property
    def height(self) -> int:
        return _HEAD + _ROW * len(self.state.arrows) + (4 if self.state.arrows else 0)

    @property
    def middle(self) -> int:
        """Return the height at which lines arrive."""
        return self.top + _HEAD // 2

    def row(self, number: int) -> int:
        """Return the middle of a row."""
        return self.top + _HEAD + _ROW * number + _ROW // 2


def states_svg(title: str, states: Sequence[DiagramState]) -> str:
    """Return the picture of a sequence; steps above `MOST_STATES` are left out."""
    boxes: dict[str, _Box] = {}
    top = 26
    for state in states[:MOST_STATES]:
        boxes[state.name] = box = _Box(state, top)
        top += box.height + _GAP
    lanes = _lanes(boxes)
    width = _WIDTH + _ROOM + _LANE * (max(lanes.values(), default=-1) + 1)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-1 0 {width + 2} {top}" width="{width + 2}" height="{top}" '
        f'role="img" class="states">',
        f"<title>{_text(title)}</title>",
        '<circle cx="20" cy="9" r="5" class="start"/><path class="line" d="M20 14V22"/>',
        '<path class="tip" d="M16 19h8l-4 7z"/>',
    ]
    for name, lane in lanes.items():
        parts.append(_lines_to(name, boxes, _WIDTH + 14 + _LANE * lane))
    parts += [_drawn(box, set(boxes)) for box in boxes.values()]
    return "".join([*parts, "</svg>"])


def _has_line(arrow: Arrow, state: DiagramState) -> bool:
    """Return whether a line is drawn for a transition: it leads to another step."""
    return arrow.target.kind == "step" and arrow.target.name != state.name


def _lanes(boxes: dict[str, _Box]) -> dict[str, int]:
    """Return the number of the vertical line of each step that lines lead to, from the boxes outwards."""
    spans: dict[str, tuple[int, int]] = {}
    for box in boxes.values():
        for number, arrow in enumerate(box.state.arrows):
            if _has_line(arrow, box.state) and arrow.target.name in boxes:
                target = boxes[arrow.target.name]
                low, high = spans.get(arrow.target.name, (target.middle, target.middle))
                spans[arrow.target.name] = min(low, box.row(number)), max(high, box.row(number))
    lanes: dict[str, int] = {}
    for name, (low, high) in sorted(spans.items(), key=lambda one: one[1][1] - one[1][0]):
        taken = {lanes[other] for other in lanes if spans[other][0] <= high and low <= spans[other][1]}
        lanes[name] = next(lane for lane in range(len(spans)) if lane not in taken)
    return lanes


def _lines_to(name: str, boxes: dict[str, _Box], across: int) -> str:
    """Return the lines to a step, which meet in the vertical line at `across`."""
    target = boxes[name]
    rows = [
        box.row(number)
        for box in boxes.values()
        for number, arrow in enumerate(box.state.arrows)
        if _has_line(arrow, box.state) and arrow.target.name == name
    ]
    low, high = min([*rows, target.middle]), max([*rows, target.middle])
    path = "".join(f"M{_WIDTH} {row}H{across}" for row in rows)
    path += f"M{across} {low}V{high}M{across} {target.middle}H{_WIDTH + 8}"
    tip = f"M{_WIDTH + 9} {target.middle - 4}v8l-8 -4z"
    return f'<g class="to"><path class="line" d="{path}"/><path class="tip" d="{tip}"/></g>'


def _drawn(box: _Box, known: set[str]) -> str:
    state = box.state
    does = state.does.removeprefix(state.name).removeprefix(" · ")
    parts = [
        f'<rect x="0" y="{box.top}" width="{_WIDTH}" height="{box.height}" rx="6" class="state"/>',
        f'<text x="10" y="{box.middle + 4}" class="name">{_text(state.name)}</text>',
        _cut_text(18 + _LETTER * 1.15 * len(state.name), box.middle + 4, does, _WIDTH - 10, "does"),
    ]
    for number, arrow in enumerate(state.arrows):
        row = box.row(number) + 4
        word, look = _target(arrow, state, known)
        left = _WIDTH - 12 - _LETTER * len(word)
        parts.append(_cut_text(22, row, arrow.label or "then", left - 8, "event"))
        parts.append(f'<text x="{_WIDTH - 8}" y="{row}" text-anchor="end" class="{look}">{_text(word)}</text>')
    return f"<g>{''.join(parts)}</g>"


def _target(arrow: Arrow, state: DiagramState, known: set[str]) -> tuple[str, str]:
    """Return the word for the end of a transition, and its class."""
    kind, name = arrow.target
    if kind == "failed":
        return f"fails: {name}", "fails"
    if kind == "end":
        return "done", "ends"
    if name == state.name:
        return "↻ again", "target"
    return (name, "target") if name in known else (f"{name} …", "target")


def _cut_text(left: float, top: int, text: str, right: float, look: str) -> str:
    """Return a text that is cut at the right edge, with the whole text as its title."""
    most = max(1, int((right - left) / _LETTER))
    shown = text if len(text) <= most else text[: most - 1] + "…"
    return f'<text x="{left:.0f}" y="{top}" class="{look}"><title>{_text(text)}</title>{_text(shown)}</text>'


def _text(text: str) -> str:
    return escape("".join(sign if sign.isprintable() else "�" for sign in text), quote=False)
