"""Flights of a scenario whose parts are chosen each on its own."""
