"""The checker: errors that can be found before anything runs, from the model alone (guide: checker)."""
