"""The generated parts of `docs/cli.md`: usage, options and examples of each verb, from its parser.

`python tools/cli_page.py` writes them after the marks `<!-- verbs -->` and `<!-- options -->`; a test compares the page
with the parser.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from framekit.cli.parser import build_parser
from framekit.cli.verb_table import GROUPS, VERBS, examples_of

PAGE = Path(__file__).parents[1] / "docs" / "cli.md"
PART = re.compile(r"<!-- (verbs|options) -->\n.*?<!-- end -->\n", re.DOTALL)


def verbs_text() -> str:
    """Return the table of all verbs by groups."""
    rows = [
        f"| {group if first else ''} | [`{verb}`](#options-of-{verb}) | {row.about} |"
        for group, verbs in GROUPS.items()
        for first, (verb, row) in zip((True, *(False,) * len(verbs)), verbs.items(), strict=False)
    ]
    return "\n".join(["| group | verb | what it does |", "|---|---|---|", *rows])


def options_text(verb: str) -> str:
    """Return usage, arguments and examples of a verb."""
    parser = build_parser(verb).verbs[verb]
    actions = [action for action in parser._actions if action.dest != "help" and action.help != argparse.SUPPRESS]
    rows = [f"| {_name(action)} | {_about(action)} |" for action in actions]
    examples = "\n".join(examples_of(verb))
    return "\n".join(
        [
            f"### Options of {verb}", "", "| argument | meaning |", "|---|---|", *rows, "",
            "```text", examples, "```",
        ]
    )  # fmt: skip


def _name(action: argparse.Action) -> str:
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    value = metavar or (action.dest.upper() if action.nargs != 0 else "")
    if action.choices is not None and not metavar:
        value = "|".join(map(str, action.choices))
    if not action.option_strings:
        more = "…" if action.nargs in ("+", "*") else ""
        return _code(f"{value}{more}")
    shown = f" [{value}]" if action.nargs == "?" else f" {value}" if action.nargs != 0 else ""
    return ", ".join(_code(f"{option}{shown}") for option in action.option_strings)


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`"


def _about(action: argparse.Action) -> str:
    return (action.help or "").replace("%%", "%").replace("|", "\\|")


def generated(page: str) -> str:
    """Return the page with its generated parts made anew."""

    def part(match: re.Match[str]) -> str:
        text = verbs_text() if match[1] == "verbs" else "\n\n".join(map(options_text, VERBS))
        return f"<!-- {match[1]} -->\n{text}\n<!-- end -->\n"

    return PART.sub(part, page)


def main() -> None:
    PAGE.write_text(generated(PAGE.read_text("utf-8")), "utf-8")


if __name__ == "__main__":
    main()
