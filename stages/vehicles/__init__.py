"""Vehicles: native models from vehicle files, frames, fences."""
