"""Expressions: parsed into a whitelisted tree, written out as Python from it. Never evaluated from text."""
