"""`fly`: one flight, from its files to its verdict."""
