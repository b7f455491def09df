"""Codecs: check codes, number forms, and the compiler of frames to Python."""
