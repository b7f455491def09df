"""Speed as ratios, measured alternately in one run.

`python -m benchmarks` (or `make bench`) prints all of them.
"""
