"""One viewer of scenes, maps, plans and flights: what is shown, how it is drawn, and where."""
