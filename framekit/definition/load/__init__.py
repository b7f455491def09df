"""Loaders: from nodes with positions to the model. They resolve every reference and collect every problem."""
