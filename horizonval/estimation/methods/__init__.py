"""One estimator, one file."""
