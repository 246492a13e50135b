"""The simulated Crazyflie."""
