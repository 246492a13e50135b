"""Splat files in, scenes out."""
