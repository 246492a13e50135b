"""Flights among moving obstacles."""
