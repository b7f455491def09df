"""Explain and carry out command blocks (`framekit commreq`), and execute the jobs of a run (`jobs:`)."""
