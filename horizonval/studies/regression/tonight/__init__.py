"""One night: what is asked of it, what its units brought together, how it compares, and what follows."""
