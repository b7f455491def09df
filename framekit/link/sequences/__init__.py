"""Sequences of the link procedure: compiled to one Python function a step, and what runs them."""
