"""Suites: from a TOML file to frames, from frames to rows of results."""
