"""Covers as maps that a microcontroller reads in place."""
