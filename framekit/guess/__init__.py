"""What can be said of a line without a manual: where frames begin and end, which bytes are what, and the check.

Nothing here knows a protocol. Every statement comes with its evidence: so many of so many.
"""
