"""Refraction: air in apparent-radius (Bouguer) coordinates, bending angles, where sunlight comes from."""
