"""Splat formats: from the bytes of a file to Gaussians, one module per format."""
