"""The checker: what can be known to be wrong before anything runs, from the model alone (guide: checker)."""
