"""Prints how large every distribution of this environment is on disk, the largest first.

A file to which several names lead counts once. Compiled Python files, which are made on installation, are counted with
their distribution and told beside.
"""

import importlib.metadata
import os


def main() -> None:
    """Print the table."""
    sizes: dict[str, int] = {}
    compiled = 0
    seen = set()
    for distribution in importlib.metadata.distributions():
        for file in distribution.files or ():
            try:
                entry = os.stat(distribution.locate_file(file))
            except OSError:
                continue
            if (entry.st_dev, entry.st_ino) in seen:
                continue
            seen.add((entry.st_dev, entry.st_ino))
            sizes[distribution.name] = sizes.get(distribution.name, 0) + entry.st_size
            compiled += entry.st_size if file.suffix == ".pyc" else 0
    small = sum(size for size in sizes.values() if size < 5e6)
    for name, size in sorted(sizes.items(), key=lambda item: -item[1]):
        if size >= 5e6:
            print(f"{size / 1e6:7.0f} MB  {name}")
    print(f"{small / 1e6:7.0f} MB  all others")
    print(f"{sum(sizes.values()) / 1e6:7.0f} MB  together, {compiled / 1e6:.0f} MB of it compiled Python files")


if __name__ == "__main__":
    main()
