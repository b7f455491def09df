"""The generated parts of `docs/cli.md` and `docs/cli/*.md`: table of verbs, examples and options, from the parser.

`python tools/cli_page.py` writes them after the marks `<!-- verbs -->`, `<!-- shared -->`, `<!-- examples VERB -->` and
`<!-- options VERB -->`; a test compares the pages with the parser. An option that several verbs have with the same
meaning is described once, in the index.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from pathlib import Path

from framekit.cli.parser import build_parser
from framekit.cli.verb_table import GROUPS, VERBS, examples_of

DOCS = Path(__file__).parents[1] / "docs"
INDEX = DOCS / "cli.md"
PAGES = [INDEX, *sorted((DOCS / "cli").glob("*.md"))]
MARK = re.compile(r"<!-- (verbs|shared|examples|options)(?: (\w+))? -->\n.*?<!-- end -->\n", re.DOTALL)
SHARED_BY = 3
"""From how many verbs on an option is described in the index only."""

Row = tuple[str, str]
"""An argument as it is written, and its meaning."""


def rows_of(verb: str) -> list[Row]:
    """Return the arguments and options of a verb."""
    parser = build_parser(verb).verbs[verb]
    actions = [action for action in parser._actions if action.dest != "help" and action.help != argparse.SUPPRESS]
    return [(_name(action), _about(action)) for action in actions]


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


def shared_rows() -> list[Row]:
    """Return the rows that at least `SHARED_BY` verbs have, in the order of the verbs."""
    count = Counter(row for verb in VERBS for row in rows_of(verb))
    return [row for row, verbs in count.items() if verbs >= SHARED_BY]


def table(rows: list[Row]) -> list[str]:
    """Return a table of arguments; nothing for no rows."""
    lines = [f"| {name} | {about} |" for name, about in rows]
    return ["| argument | meaning |", "|---|---|", *lines] if rows else []


def verbs_text(pages: dict[Path, str]) -> str:
    """Return the table of all verbs by groups, each with a link to the section of its options."""
    place = {
        verb: f"cli/{path.name}#{verb}"
        for path, text in pages.items()
        for verb in VERBS
        if f"\n<!-- options {verb} -->\n" in text
    }
    rows = [
        f"| {group if first else ''} | [`{verb}`]({place[verb]}) | {row.about} |"
        for group, verbs in GROUPS.items()
        for first, (verb, row) in zip((True, *(False,) * len(verbs)), verbs.items(), strict=False)
    ]
    return "\n".join(["| group | verb | purpose |", "|---|---|---|", *rows])


def options_text(verb: str) -> str:
    """Return the table of the options that only few verbs have, and the names of the shared ones."""
    shared = set(shared_rows())
    own = table([row for row in rows_of(verb) if row not in shared])
    names = [name.split(" ")[0].rstrip("`") + "`" for name, _ in rows_of(verb) if (name, _) in shared]
    also = f"{'Also' if own else 'Arguments:'} {', '.join(names)} ([shared](../cli.md#options-of-several-verbs))."
    return "\n".join([*own, *([""] if own and names else []), *([also] if names else [])])


def generated(pages: dict[Path, str]) -> dict[Path, str]:
    """Return the pages with their generated parts made anew."""

    def part(match: re.Match[str]) -> str:
        kind, verb = match[1], match[2]
        if kind == "verbs":
            text = verbs_text(pages)
        elif kind == "shared":
            text = "\n".join(table(shared_rows()))
        elif kind == "examples":
            text = "\n".join(["```text", *examples_of(verb), "```"])
        else:
            text = options_text(verb)
        return f"<!-- {' '.join(filter(None, (kind, verb)))} -->\n{text}\n<!-- end -->\n"

    return {path: MARK.sub(part, text) for path, text in pages.items()}


def read_pages() -> dict[Path, str]:
    """Return the text of each page of the command line."""
    return {path: path.read_text("utf-8") for path in PAGES}


def main() -> None:
    for path, text in generated(read_pages()).items():
        path.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
