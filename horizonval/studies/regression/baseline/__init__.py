"""The accepted baseline, its packed images, the history of nights."""
