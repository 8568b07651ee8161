"""Benchmarks of this machine, each against a baseline: `python -m evidence.benchmarks.inference`, ..."""
