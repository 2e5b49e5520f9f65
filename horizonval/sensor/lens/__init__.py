"""Optics: point spread, vignetting, ghosts, scatter, stray light."""
