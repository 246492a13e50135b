"""Real flights: mission, commanders, control loop, links to vehicles, recorder and verdict."""
