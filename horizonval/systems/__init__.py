"""Five published systems, reproduced."""
