"""Attitude from an image: limb points, shapes, methods, guards, and the processes that contain them."""
