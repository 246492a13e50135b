"""The simulated autopilot: a vehicle that answers MAVLink as ArduPilot Copter was seen to."""
