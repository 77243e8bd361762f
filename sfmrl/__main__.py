"""`python -m sfmrl`."""

from sfmrl.cli import main

if __name__ == "__main__":
    main()
