"""System B: local vertical from two perpendicular visible cameras."""
