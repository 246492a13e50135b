"""Vehicles, trajectories, planning and simulation."""
