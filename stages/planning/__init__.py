"""Trajectories through a map that are proven clear of it."""
