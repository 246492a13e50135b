"""Commands: each parses, calls one verb and prints."""
