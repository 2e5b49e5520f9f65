"""Derivatives of frames: by attitude, position, and what the air is like."""
