"""Light from where it falls: which ground lit the air that a ray crosses, and the sky above a place."""
