"""Logs of runs: the one writer, the channels and their schemas."""
