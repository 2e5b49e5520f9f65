"""Estimates, intervals, gates and the verdict."""
