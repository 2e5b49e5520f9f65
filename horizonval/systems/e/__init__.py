"""Where a satellite is, from the directions in which two ground stations see it."""
