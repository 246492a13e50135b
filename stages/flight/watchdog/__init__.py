"""Watchdog of a flight: a process that stops and lands the vehicle when the control loop ends or stalls."""
