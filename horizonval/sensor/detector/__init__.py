"""Detectors: electrons, noise, defects, digital numbers."""
