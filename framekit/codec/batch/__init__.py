"""Many frames at once, in columns: the values that `decode` gives, worked out with NumPy where it is installed."""
