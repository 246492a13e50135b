"""Logs of runs: the writer, channels and schemas, messages and maps."""
