"""Spectra: bands and their nodes, sunlight, Planck's law, thermal absorption."""
