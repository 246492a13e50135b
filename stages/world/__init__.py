"""The one builder of what flies and what it flies in: scenario, vehicle and maps become native parts."""
