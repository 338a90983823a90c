"""The GPU backend: the same scenes as on the CPU, out of core, at the rate of the screen."""
