"""What exists: Dagster asset and asset-check definitions only, thin sentences over `deltasafe`."""
