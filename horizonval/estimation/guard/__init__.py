"""Guards: what a method's answer must pass before it is claimed."""
