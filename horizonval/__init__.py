"""Physically based rendering validation of Earth horizon sensors."""

__version__ = "0.1.0"
