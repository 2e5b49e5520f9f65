"""The keys of a camera file."""
