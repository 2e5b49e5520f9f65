"""Where the satellite is, from directions: triangulation, filters, smoothing."""
