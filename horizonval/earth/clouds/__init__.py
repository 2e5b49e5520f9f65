"""Clouds: where they are and what they do to light."""
