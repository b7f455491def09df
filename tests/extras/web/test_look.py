"""The stylesheet keeps WCAG AA: every text has a contrast of 4.5 to its background, in light and dark; lines have 3."""

from __future__ import annotations

import re
from itertools import product

import pytest

pytest.importorskip("starlette")

from framekit.extras.web.assets import PAGE

COLOUR = re.compile(r"--([a-z0-9-]+):\s*light-dark\((#[0-9a-f]{3,6}),\s*(#[0-9a-f]{3,6})\)")
SHEETS = {file.name: file.read_text("utf-8") for file in PAGE.glob("*.css")}
GROUNDS = ("card", "page", "soft", "picked")
SHADES = (
    "mark", "constant", "function", "length", "count", "counter", "copy", "check", "letters", "value", "named",
    "named1", "named2", "named3",
)  # fmt: skip
SERIES = tuple(f"s{number}" for number in range(6))
TEXTS = [
    *product(("text", "muted", "accent"), GROUNDS),
    *product(("good", "warn", "bad"), ("card", "soft", "picked")),
    ("good", "good-soft"), ("warn", "warn-soft"), ("bad", "bad-soft"), ("card", "bad"), ("card", "chosen"),
    *(("text", shade) for shade in SHADES),
]  # fmt: skip


def colours(scheme: int) -> dict[str, tuple[int, ...]]:
    """Return the named colours of all stylesheets, for light (0) or dark (1)."""
    found = {}
    for sheet in SHEETS.values():
        for name, *values in COLOUR.findall(sheet):
            digits = values[scheme][1:]
            digits = digits if len(digits) == 6 else "".join(2 * digit for digit in digits)
            found[name] = tuple(bytes.fromhex(digits))
    return found


def mixed(colour: tuple[int, ...], ground: tuple[int, ...], part: float) -> tuple[int, ...]:
    """Return a colour mixed into a background."""
    return tuple(round(part * one + (1 - part) * other) for one, other in zip(colour, ground, strict=True))


def contrast(first: tuple[int, ...], second: tuple[int, ...]) -> float:
    """Return the contrast ratio of two colours by the definition of WCAG 2."""

    def luminance(colour: tuple[int, ...]) -> float:
        parts = (value / 255 for value in colour)
        red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    dark, light = sorted((luminance(first), luminance(second)))
    return (light + 0.05) / (dark + 0.05)


def test_the_ratio_is_that_of_wcag() -> None:
    assert contrast((0, 0, 0), (255, 255, 255)) == pytest.approx(21)
    assert contrast((118, 118, 118), (255, 255, 255)) == pytest.approx(4.54, abs=0.01)


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_texts_can_be_read(scheme: int) -> None:
    known = colours(scheme)
    ratios = {f"{text} on {ground}": contrast(known[text], known[ground]) for text, ground in TEXTS}
    for name, part in product(SERIES, (0.2, 0.4)):
        ratios[f"text on {part:.0%} {name}"] = contrast(known["text"], mixed(known[name], known["card"], part))
    assert {name: round(ratio, 2) for name, ratio in ratios.items() if ratio < 4.5} == {}


@pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
def test_lines_of_charts_and_edges_of_fields_can_be_seen(scheme: int) -> None:
    known = colours(scheme)
    ratios = {name: contrast(known[name], known["card"]) for name in (*SERIES, "accent", "edge")}
    assert {name: round(ratio, 2) for name, ratio in ratios.items() if ratio < 3} == {}


def test_only_named_colours_are_used() -> None:
    for name, sheet in SHEETS.items():
        used = re.findall(
            r"#[0-9a-f]{3,8}\b", re.sub(r"^\s*--.*$|box-shadow:[^;]*;|::backdrop[^}]*}", "", sheet, flags=re.M)
        )
        assert used == [], name
