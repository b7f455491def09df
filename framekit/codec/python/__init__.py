"""The Python compiler: from the model of a protocol to the source of a module of plain functions.

It writes text and knows nothing of engines or lines; what it writes needs no framekit.
"""
