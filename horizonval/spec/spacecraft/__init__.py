"""Keys of what the spacecraft itself is."""
