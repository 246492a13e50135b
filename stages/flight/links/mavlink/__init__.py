"""Link to ArduPilot Copter and PX4 over MAVLink."""
