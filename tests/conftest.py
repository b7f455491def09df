"""What holds for every test: none is timed, generated examples included."""

import gc

from hypothesis import settings

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

gc.set_threshold(
    100_000, 50, 100
)  # thousands of tests keep much; looking through it over and over costs a fifth of the time
