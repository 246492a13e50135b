"""Simulated flights and their verdicts."""
