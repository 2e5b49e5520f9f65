"""Cameras as calibration programs write them."""
