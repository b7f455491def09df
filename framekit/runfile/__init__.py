"""Readers of run, device, fault plan and job files: from YAML to the values that runs work with."""
