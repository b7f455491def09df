"""framekit from Python, async and sync: clients, codecs, simulated devices, runs. `import framekit` offers it all."""
