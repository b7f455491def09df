"""The pages of the documentation as tests read them: their snippets, sentences, headings and links."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TOP = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md"]
CHECKLISTS = sorted((ROOT / "tests" / "checklists").glob("*.md"))
PAGES = [*TOP, ROOT / "examples" / "README.md", *sorted(DOCS.glob("**/*.md"))]
GUIDE = [DOCS / "language.md", *sorted((DOCS / "language").glob("*.md"))]
"""The guide to the language: pages that people read from top to bottom."""
EXAMPLES = ROOT / "examples"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"(?:# |/\* )file: (\S+)(?: \*/)?")


@dataclass(frozen=True)
class Snippet:
    """One fenced block of a page."""

    kind: str
    text: str
    line: int

    @property
    def file(self) -> str | None:
        """Return the name in the block's file comment, or None."""
        found = FILE.fullmatch(self.text.split("\n", 1)[0].strip())
        return None if found is None else found[1]


def excerpt_of(snippet: Snippet) -> Path | None:
    """Return the file below `examples/` that a block shows, whole or in part; None for a block that is its own file."""
    stored = None if snippet.file is None else EXAMPLES / snippet.file
    return stored if stored is not None and stored.is_file() else None


def shows(snippet: Snippet, stored: str) -> bool:
    """Return whether a block has the lines of the stored file; a line `...` stands for any lines."""
    lines = snippet.text.split("\n", 1)[1].splitlines()
    pattern = "".join("(?:.*\n)*" if line.strip() == "..." else re.escape(line) + "\n" for line in lines)
    return re.fullmatch(pattern, stored) is not None


def snippets(page: Path) -> list[Snippet]:
    text = page.read_text(encoding="utf-8")
    return [Snippet(found[1], found[2], text.count("\n", 0, found.start()) + 1) for found in FENCE.finditer(text)]


def anchors(page: Path) -> set[str]:
    """Return the possible targets of links into a page: its headings as GitHub anchors."""
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text("utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def links(page: Path) -> Iterator[tuple[str, str]]:
    """Return the links of a page to files of the project: the file as written, and the heading."""
    text = re.sub(r"`[^`\n]*`", "", FENCE.sub("", page.read_text("utf-8")))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not re.match(r"[a-z]+:", target):
            file, _, heading = target.partition("#")
            yield file, heading


def sentences(page: Path) -> Iterator[str]:
    """Yield the sentences of a page, including lists and tables; an example in backquotes counts as a word."""
    text = FENCE.sub("\n\n", page.read_text("utf-8"))
    text = re.sub(r"`[^`\n]*`", "CODE", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*#]|\d+\.) )|\||\n(?=#)", text):
        for sentence in re.split(r"(?<=[.!?:])[*)]*\s", " ".join(block.split())):
            if sentence.strip():
                yield sentence.strip()
