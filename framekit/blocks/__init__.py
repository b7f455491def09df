"""Blocks: the run model, triggers and the scheduler. Sans-I/O: no clock, no port, no task."""
