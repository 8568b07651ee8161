"""Dagster assets and asset checks: thin calls of `deltasafe`."""

import warnings

import dagster as dg

# beta and preview features of Dagster 1.13 that the tests cover: single-run backfills, partitioned checks
warnings.filterwarnings("ignore", category=dg.BetaWarning)
warnings.filterwarnings("ignore", message="Specifying a partitions_def on an AssetCheckSpec")
