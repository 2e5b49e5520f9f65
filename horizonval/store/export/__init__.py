"""Frames and images as files of other programs, and those that can be read back."""
