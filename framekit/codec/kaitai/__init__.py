"""A Kaitai Struct file from a definition. `generate` puts it together; what Kaitai cannot say is told."""
