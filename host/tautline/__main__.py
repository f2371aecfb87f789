"""`python -m tautline` is `taut`."""

from tautline.cli import main

main()
