"""The kinds of segments, one module each, and what all of them have in common."""
