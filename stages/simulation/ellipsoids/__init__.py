"""Flights of a rigid body among the ellipsoids of a scene."""
