"""System F: a conical scanner, and what cold clouds do to it."""
