"""Decode many captures into tables: frames as Parquet in several processes, values of devices as CSV."""
