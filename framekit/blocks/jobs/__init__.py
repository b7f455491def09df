"""Jobs: numbered slots in which a transfer repeats by itself, with their status words and status bits."""
