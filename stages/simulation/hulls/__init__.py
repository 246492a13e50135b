"""Flights of a point mass among the hulls of a cover."""
