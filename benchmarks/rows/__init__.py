"""One module per row of the table. Each has NAME, TARGET and `run(rounds) -> list[Row]` (`benchmarks.row`)."""

MODULES = (
    "codecs", "libraries", "generated_c", "receiver", "noise", "capture",
    "poll", "services", "points", "event_loop", "channels", "line_use", "idle_blocks", "trigger", "startup", "memory",
)  # fmt: skip
"""The modules in the order of the table."""
