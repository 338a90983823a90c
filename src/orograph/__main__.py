"""Run the command line as ``python -m orograph``."""

from orograph.cli import main

main()
