"""Write documents with `framekit generate WHAT PROTOCOL`: pages for readers, diagrams, types of values."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from framekit.api.vectors import vectors_path
from framekit.cli.common import VerbError, WordsError, load, load_codec, why_not
from framekit.cli.generate_verb import refuse_params, write_text
from framekit.definition.load.protocol import definition_path
from framekit.extras.documents.diagrams import diagrams
from framekit.extras.documents.document import document, html, markdown
from framekit.extras.documents.value_types import json_schema, typescript


def write_json_schema(arguments: argparse.Namespace) -> int:
    """Write the JSON Schema of decoded values."""
    protocol = load_codec(arguments.protocol).protocol
    refuse_params(arguments)
    return write_text(arguments, json.dumps(json_schema(protocol), indent=1, ensure_ascii=False) + "\n")


def write_typescript(arguments: argparse.Namespace) -> int:
    """Write the types of decoded values in TypeScript."""
    protocol = load_codec(arguments.protocol).protocol
    refuse_params(arguments)
    return write_text(arguments, typescript(protocol))


def write_diagram(arguments: argparse.Namespace) -> int:
    """Write the sequences of a protocol as state diagrams. Raises VerbError if it has none."""
    protocol = load_codec(arguments.protocol).protocol
    refuse_params(arguments)
    if not protocol.sequences:
        raise VerbError(f"'{protocol.name}' has no sequences – there is nothing to draw")
    return write_text(arguments, diagrams(protocol))


def write_document(arguments: argparse.Namespace) -> int:
    """Write a page, or Markdown with a folder of pictures."""
    place: Path | None = arguments.output
    if place is None or place.suffix not in (".html", ".md"):
        raise WordsError("a document is written into a file – add -o NAME.html or -o NAME.md")
    blocks = document(load(arguments.protocol), vectors_path(definition_path(arguments.protocol)))
    folder = place.with_suffix(".frames")
    text, pictures = (html(blocks), {}) if place.suffix == ".html" else markdown(blocks, folder.name)
    try:
        place.write_text(text, encoding="utf-8")
        if pictures:
            folder.mkdir(exist_ok=True)
        for name, picture in pictures.items():
            (folder / name).write_text(picture, encoding="utf-8")
    except OSError as error:
        raise VerbError(f"cannot write {why_not(error, place)}") from None
    return 0
