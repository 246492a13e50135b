"""Metric alignment of a scene by a similarity."""
