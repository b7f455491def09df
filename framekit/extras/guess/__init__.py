"""Analysis of an unknown line from captured bytes: framing, fields of frames, check code, times.

The analysis uses no knowledge of particular protocols. Each statement carries its evidence: the number of frames that
agree, out of how many.
"""
