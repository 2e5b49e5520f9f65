"""System A: altitude-free image sensor."""
