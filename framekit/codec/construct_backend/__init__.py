"""The construct back end: every frame of a protocol as a `construct` object, the reference for what frames mean.

`compile_construct` makes them from the model; users nest them in constructs of their own. It shares no code with the
Python compiler but plain functions for digits, conversions and check methods.
"""

from framekit.codec.construct_backend.codec import ConstructCodec
from framekit.codec.construct_backend.compiler import compile_construct
from framekit.codec.construct_backend.frame import FrameConstruct

__all__ = ["ConstructCodec", "FrameConstruct", "compile_construct"]
