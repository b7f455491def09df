"""Compile the model of a protocol to the source of a Python module of plain functions.

The compiler only writes source and is independent of engines and lines; its output does not need framekit.
"""
