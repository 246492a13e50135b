"""The stages: pure functions from artifacts to artifacts."""
