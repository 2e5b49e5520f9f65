"""Limb points in an image: where the limb is, by the likelihood of its profiles, and what speaks against it."""
