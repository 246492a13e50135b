"""Artifacts: kinds, manifests, parts, provenance, and their files."""
