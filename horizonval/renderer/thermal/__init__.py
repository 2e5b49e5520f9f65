"""Thermal bands: marched on table rays, interpolated to pixels."""
