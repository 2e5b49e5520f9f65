"""Clouds: positions and optical properties."""
