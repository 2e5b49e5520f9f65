"""Limb points in an image: edges, crossings, consensus, and what speaks against them."""
