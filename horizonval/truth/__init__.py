"""Exact truth of a frame, float64 and closed form; no renderer has a part in it."""
