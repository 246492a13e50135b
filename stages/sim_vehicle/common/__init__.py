"""Parts that the simulated autopilots share."""
