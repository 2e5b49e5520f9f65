"""System C: ideal sensor module."""
