"""The keys of the schema that occur in executed examples: those of the guide, and the cases of segments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import yaml
from docs.pages import EXAMPLES, GUIDE, excerpt_of, snippets
from reference_page import PagePart, Reference, Schema
from segment_cases import SECTIONS

Key = tuple[str, str]
"""A part of the reference page and a key of it."""
SHARED = {"segment_name", "when", "refuse", "number_order", "digit_case"}
"""Definitions of the schema that many segments share as a single key."""


def examples() -> Iterator[dict[str, Any]]:
    """Yield every protocol file of the guide, and the protocols of the cases of segments."""
    texts = [
        snippet.text for page in GUIDE for snippet in snippets(page) if snippet.file and excerpt_of(snippet) is None
    ]
    texts += [file.read_text("utf-8") for file in (EXAMPLES / "language").glob("*.yaml")]
    texts += [case.yaml for cases in SECTIONS.values() for case in cases]
    for text in texts:
        found = yaml.load(text, yaml.BaseLoader)
        if "protocol" in found or "application" in found:
            yield found


class Used:
    """Collect the keys of values, by the names of the parts of the reference page."""

    def __init__(self, reference: Reference) -> None:
        self.reference = reference
        self.keys: set[Key] = set()

    def all_keys(self) -> set[Key]:
        """Return every key of the schema but `doc`, which is for readers."""
        return {
            self.key_of(part, key)
            for part in self.reference.parts.values()
            for key in part.schema["properties"]
            if key != "doc"
        }

    def key_of(self, part: PagePart, key: str) -> Key:
        """Return the part and name of a key; a key that many parts share belongs to `any segment`."""
        shared = str(part.schema["properties"][key].get("$ref", "")).partition("#/$defs/")[2]
        return ("any segment" if shared in SHARED else part.name, key)

    def visit(self, schema: Schema, value: object) -> None:
        """Record the keys of a value and of its content."""
        if "$ref" in schema:
            self.visit(self.reference.target(schema["$ref"]), value)
        elif isinstance(value, dict):
            self.visit_mapping(schema, value)
        elif isinstance(value, list):
            for item in value:
                self.visit(schema.get("items", {}), item)

    def visit_mapping(self, schema: Schema, value: Mapping[str, object]) -> None:
        for kind, part in schema.get("dependentSchemas", {}).items():
            if kind in value:
                self.visit(part, value)
        if "then" in schema and "properties" not in schema:  # a handler is an action, or a list of them
            self.visit(schema["then"], value)
        known = schema.get("properties", {})
        part = self.reference.parts.get(id(schema))
        others = schema.get("additionalProperties")
        for key, inside in value.items():
            if key in known:
                if part is not None:
                    self.keys.add(self.key_of(part, key))
                self.visit(known[key], inside)
            elif isinstance(others, dict):
                self.visit(others, inside)
