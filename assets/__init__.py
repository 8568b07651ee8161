"""What exists: Dagster asset and asset-check definitions only, thin sentences over `deltasafe`."""

import warnings

import dagster as dg

# single-run backfills are marked as beta in Dagster 1.13; a test here runs them for real
warnings.filterwarnings("ignore", category=dg.BetaWarning)
