"""The reference for generated code: every frame of a protocol, compiled a second time to constructs.

`compile_construct` makes the constructs from the model. It shares no code with the Python compiler except plain
functions for digits, conversions and check methods.
"""

from construct_oracle.codec import ConstructCodec
from construct_oracle.compiler import compile_construct
from construct_oracle.frame import FrameConstruct

__all__ = ["ConstructCodec", "FrameConstruct", "compile_construct"]
