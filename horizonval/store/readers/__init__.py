"""Readers of other programs' pictures: one module for each library that decodes them."""
