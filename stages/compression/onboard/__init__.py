"""Onboard maps: covers in a layout that a microcontroller reads in place."""
