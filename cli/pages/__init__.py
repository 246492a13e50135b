"""Reference pages of the documentation, made from the parsers, the schemas and the docstrings."""
