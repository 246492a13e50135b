"""Artifact kinds, manifests, configurations and errors."""
