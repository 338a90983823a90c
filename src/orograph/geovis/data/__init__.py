"""Data and their uncertainty on the terrain that they belong to ([page](docs/data.md))."""
