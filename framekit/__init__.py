"""framekit: protocols of serial field devices described in YAML, and run."""

__version__ = "0.1.0"
