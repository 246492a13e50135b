"""Parameters of the stages, one module per command; all of them end up in the output's manifest."""
