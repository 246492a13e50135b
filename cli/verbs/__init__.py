"""Verbs: one typed function per command, which the command line and `import alula` share."""
