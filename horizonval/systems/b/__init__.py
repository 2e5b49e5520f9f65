"""System B: local vertical from two perpendicular cameras, and its test bench."""
