"""Lua from a definition: a dissector for Wireshark. `generate` puts it together, `reader.lua` reads frames in it."""
