"""Measurements of this machine, each against what one would write first: `python -m benchmarks.inference`, ..."""
