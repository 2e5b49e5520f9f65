"""Orbits and attitudes as flight dynamics writes them."""
