"""Runs on a Ray cluster of two hosts, compared with runs on one machine: ``python -m evidence.scale``."""
