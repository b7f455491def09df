"""Services: what brings engines, ports, clocks and blocks together. Callback-based on a clock, real or virtual."""

import logging

logging.getLogger("framekit").addHandler(logging.NullHandler())
