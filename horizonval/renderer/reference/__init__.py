"""Cross-checks in stock Mitsuba: Monte Carlo frames, scene files."""
