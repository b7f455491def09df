"""Explain and carry out command blocks (`framekit commreq`)."""
