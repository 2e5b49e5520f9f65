"""Images to learn from, with exact truth, made again from a list of seeds alone."""
