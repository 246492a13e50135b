"""Parameters: of filters, as TOML with generators, and of commands."""
