"""Contain the optional parts of framekit: a package for each, with the name of its pip extra if it needs libraries."""
