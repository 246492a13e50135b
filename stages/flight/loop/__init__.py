"""The loop that flies: supervisor, checks and watches."""
