"""Flights of a racing drone inside a geofence."""
