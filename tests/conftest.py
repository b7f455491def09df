"""What holds for every test: none is timed, generated examples included; what was loaded and compiled is kept long."""

import gc

from hypothesis import settings

from framekit.codec import codec
from framekit.definition.load import protocol as library

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

gc.set_threshold(
    100_000, 50, 100
)  # thousands of tests keep much; looking through it over and over costs a fifth of the time

codec.MOST_KEPT = library.MOST_KEPT = 512
"""Hundreds of small definitions come between two tests of a shipped one, which takes seconds to compile."""
