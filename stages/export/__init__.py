"""Formats of other programs: maps and vehicles for simulators, logs for ROS 2, layouts for Foxglove."""
