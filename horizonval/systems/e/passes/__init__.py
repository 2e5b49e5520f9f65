"""Stations' frames of the satellite, rendered and reduced."""
