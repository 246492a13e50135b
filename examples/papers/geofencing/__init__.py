"""Claims, tables, figures and verdicts of the geofencing paper (arXiv 2201.04331)."""
