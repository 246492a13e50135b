"""Barriers and safety filters behind one protocol."""
