"""Scenarios, missions and vehicles: the files that users write."""
