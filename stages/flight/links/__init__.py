"""Links to vehicles: the connections to real and simulated autopilots."""
