"""Convert between definitions and Kaitai Struct files.

`generate` writes a file from a definition, `importing` a definition from a file. Parts without a counterpart are
reported.
"""
