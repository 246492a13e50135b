"""The simulated PX4 multicopter, derived from the simulated ArduPilot Copter."""
