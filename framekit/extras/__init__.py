"""Extras: each folder is one part that the core does without, named as its pip extra where it has one."""
