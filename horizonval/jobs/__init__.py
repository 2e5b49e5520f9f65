"""The engine: do items on all processors, keep each result under its digest, go on after a break."""
