"""Parts that the simulated vehicles share; nothing here depends on a firmware."""
