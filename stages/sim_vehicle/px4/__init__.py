"""A simulated PX4 multicopter."""
