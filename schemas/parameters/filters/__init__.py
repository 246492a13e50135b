"""Source of all filter parameters (`*.toml`), and the generators of what follows from it."""
