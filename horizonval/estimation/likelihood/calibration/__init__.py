"""The camera itself as an unknown: what many frames of one camera say of it."""
