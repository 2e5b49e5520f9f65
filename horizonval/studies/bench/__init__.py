"""A benchmark of horizon sensing: frozen frames, submissions run apart from the truth, one sheet of scores."""
