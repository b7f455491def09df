"""Services: what brings engines, ports, clocks and blocks together. Callback-based on a clock, real or virtual."""
