"""Make documents of a definition: pages for readers, state diagrams, and types of decoded values for other programs."""
