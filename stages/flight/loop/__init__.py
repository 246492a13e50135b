"""Control loop of a real flight: supervisor, pre-flight checks, watches and geofence."""
