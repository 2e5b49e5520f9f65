"""Designs compared by what the limb in their frames can say, without an estimator."""
