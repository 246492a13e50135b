"""From a state and a plan to a set-point."""
