"""Services: combinations of engines, ports, clocks and blocks. Callback-based on a clock, real or virtual."""

import logging

logging.getLogger("framekit").addHandler(logging.NullHandler())
