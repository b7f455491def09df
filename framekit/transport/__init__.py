"""Clocks and ports, real and simulated: the only layer that touches real I/O."""
