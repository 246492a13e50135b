"""Commanders: controllers and filters of `simulate` that compute one set-point per tick."""
