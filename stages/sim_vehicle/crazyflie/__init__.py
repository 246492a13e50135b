"""A simulated Crazyflie."""
