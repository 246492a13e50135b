"""What a flight leaves: samples, log and live view, written by processes beside it."""
