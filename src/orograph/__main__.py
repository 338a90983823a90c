"""``python -m orograph`` is the command line."""

from orograph.cli import main

main()
