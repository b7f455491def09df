"""Definitions: YAML with positions, schemas, the model, expressions, and the checker."""

ROOT_VARIABLE = "FRAMEKIT_ROOT"
"""The variable that names the folder of a project: its files may name each other by `../`."""

PATH_VARIABLE = "FRAMEKIT_PATH"
"""The variable that names more folders with definitions, as PATH does with programs."""
