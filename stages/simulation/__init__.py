"""Flights in simulation, and what they are judged by."""
