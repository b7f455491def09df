"""The command line: one small module for each verb. Large modules are imported when a verb needs them."""
