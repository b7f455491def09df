"""The link layer: frames out of bytes, sequences, services. Sans-I/O: no clock, no port, no task."""
