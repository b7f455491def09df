"""Show runs, devices and lines live in a terminal (`--screen`)."""
