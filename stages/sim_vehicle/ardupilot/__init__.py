"""The simulated ArduPilot Copter."""
