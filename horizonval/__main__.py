"""The command line as ``python -m horizonval``."""

from horizonval.cli import main

if __name__ == "__main__":
    main()
