"""Contain the optional parts of framekit: a folder for each. `framekit.table_of_extras` has what each brings."""
