"""System F: conical scanner."""
