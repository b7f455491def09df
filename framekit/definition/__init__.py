"""Definitions: YAML with positions, schemas, the model, expressions, and the checker."""
