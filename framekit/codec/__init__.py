"""Codecs: check codes, number forms, and the two compilers that stand on one model."""
