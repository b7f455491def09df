"""C99 from a definition: a header and a source that decode, encode and measure its frames, with nothing to link.

What cannot be said in C is told (`Left`), and left out: nothing here only looks done.
"""
