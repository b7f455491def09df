"""Generate Lua from a definition: a dissector for Wireshark.

`generate` assembles the file; `reader.lua` reads frames in it.
"""
