"""Frames to learn from."""
