"""New plans in flight, for a vehicle that its filter holds up."""
