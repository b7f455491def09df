"""Entries of a file that no loader has read."""

from __future__ import annotations

from framekit.definition.nodes import Mapping, read_text, unread


def tree(text: str) -> Mapping:
    node = read_text(text, "file.yaml")
    assert isinstance(node, Mapping)
    return node


def names(node: Mapping) -> list[str]:
    return [entry.key.text for _, entry in unread(node)]


def test_what_is_asked_for_counts_as_read() -> None:
    root = tree("a: 1\nb: {c: 2, d: 3}\nabout: text\n")
    inner = root.get("b")
    assert isinstance(inner, Mapping) and inner.get("c") is not None
    assert names(root) == ["a", "d"], "keys for people are no settings"
    assert [str(holder.at.line) for holder, _ in unread(root)] == ["1", "2"]


def test_looking_whether_a_key_is_there_is_no_reading() -> None:
    root = tree("a: 1\nb: 2\n")
    root.get("b")
    assert "a" in root and root.value("a") is not None
    assert names(root) == ["a"]


def test_names_that_the_author_chooses_are_all_read() -> None:
    root = tree("one: {x: 1}\ntwo: {x: 2}\n")
    for entry in root.read_all():
        assert isinstance(entry.value, Mapping)
        entry.value.get("x")
    assert names(root) == []


def test_what_is_not_loaded_at_all_is_passed_over() -> None:
    root = tree("used: {x: 1}\nlist: [{y: 1}]\n")
    root.read_all()
    assert names(root) == []


def test_a_changed_entry_and_its_first_are_read_together() -> None:
    root = tree("a: {x: 1}\nb: 2\n")
    root.get("b")
    changed = Mapping((root.entries[0].holding(root.entries[1].value),), root.at)
    changed.get("a")
    assert names(root) == []
