"""Definitions: YAML with positions, schemas, the model, expressions, and the checker."""

PATH_VARIABLE = "FRAMEKIT_PATH"
"""The variable that names more folders with definitions, as PATH does with programs."""
