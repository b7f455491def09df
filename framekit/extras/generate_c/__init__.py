"""Generate C99 from a definition: a header and a source that decode, encode and measure its frames, without libraries.

Parts without a C form are reported (`CannotSayError`) and left out, so that no generated function is incomplete.
"""
