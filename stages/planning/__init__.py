"""From a map to a trajectory that is proven clear of it."""
