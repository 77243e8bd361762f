"""`python -m sfmrl`."""

from sfmrl.cli import main

main()
