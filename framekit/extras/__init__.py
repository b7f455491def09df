"""Contain the optional parts of framekit: a folder for each. `framekit.extras_table` has what each brings."""
