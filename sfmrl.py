"""Run sfmrl from a checkout without installing it: `python sfmrl.py il`."""

from sfmrl.__main__ import main

if __name__ == "__main__":
    main()
