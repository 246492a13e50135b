"""A simulated ArduPilot Copter."""
