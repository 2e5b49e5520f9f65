"""The planet's physics as tables and closed forms, float64 numpy. Nothing here imports a renderer."""
