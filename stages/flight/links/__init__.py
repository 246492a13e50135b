"""Links to vehicles: what speaks to an autopilot, real or simulated."""
