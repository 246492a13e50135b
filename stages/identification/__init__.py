"""Identification of a vehicle: flown steps, and the fit of their responses."""
