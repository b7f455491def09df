"""The kinds of segments, one module each, and their common part."""
