"""What exists: Dagster asset and asset-check definitions only, thin sentences over `deltasafe`."""

import warnings

import dagster as dg

# marked as beta and preview in Dagster 1.13; tests here run both for real: single-run backfills, partitioned checks
warnings.filterwarnings("ignore", category=dg.BetaWarning)
warnings.filterwarnings("ignore", message="Specifying a partitions_def on an AssetCheckSpec")
