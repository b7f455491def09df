"""Decode many frames of one length together, in columns of NumPy."""
