"""What the machine gives: memory, folders for caches, names of files."""
