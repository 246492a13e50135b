"""Logs of runs and flights: a Struct for each channel, the reader of MCAP files, and the flights in them."""
