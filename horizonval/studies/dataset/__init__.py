"""Training images with exact truth, reproducible from a list of seeds."""
