"""Simulated vehicles: ArduPilot Copter and PX4 over MAVLink, and a Crazyflie over CRTP."""
