"""Recorder of a real flight: samples, and the processes that write the log and show the live view."""
