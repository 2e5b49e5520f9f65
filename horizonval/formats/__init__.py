"""Other people's files, read: cameras of calibration programs, orbits and attitudes of flight dynamics."""
