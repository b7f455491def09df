"""The command line: one small module a verb. Everything heavy is imported when its verb is carried out."""
