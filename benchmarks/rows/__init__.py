"""One module a row of the table. Each gives NAME, TARGET and `run(rounds) -> list[Row]` (`benchmarks.row`)."""

MODULES = ("codecs", "libraries")
"""The modules in the order of the table."""
