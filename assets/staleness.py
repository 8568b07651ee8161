"""Checks that partitions were made from the present versions of their inputs.

Dagster itself shows a partitioned asset as fresh, whatever happens to its inputs.
"""

import dagster as dg
from dagster._core.definitions.data_version import extract_data_provenance_from_entry, extract_data_version_from_entry

CHECK = "made_from_present_inputs"
CHECKED = ("ensemble_member", "study_cell")
"""Assets with a fixed number of partitions. Scenes are left out: an earlier motion is a record, not an input."""


def changed_inputs(instance: dg.DagsterInstance, asset: str) -> dict[str, list[str]]:
    """Return which inputs have changed since a partition was made, by partition; only those that were made."""
    key = dg.AssetKey(asset)
    present: dict[dg.AssetKey, dg.DataVersion | None] = {}
    changed: dict[str, list[str]] = {}
    for partition in sorted(instance.get_materialized_partitions(key)):
        record = instance.get_latest_data_version_record(key, partition_key=partition)
        provenance = record and extract_data_provenance_from_entry(record.event_log_entry)
        versions = provenance.input_data_versions if provenance else {}
        for upstream in versions.keys() - present.keys():
            latest = instance.get_latest_data_version_record(upstream)
            present[upstream] = latest and extract_data_version_from_entry(latest.event_log_entry)
        changed[partition] = sorted(
            upstream.to_user_string() for upstream, version in versions.items() if present[upstream] != version
        )
    return changed


def evaluation(instance: dg.DagsterInstance, asset: str) -> dg.AssetCheckEvaluation:
    """Evaluate the check of an asset from Dagster's records."""
    stale = {partition: inputs for partition, inputs in changed_inputs(instance, asset).items() if inputs}
    inputs = sorted({name for names in stale.values() for name in names})
    found = f"made from an earlier version of {', '.join(inputs)}: {', '.join(stale)}; materialize {asset} again"
    return dg.AssetCheckEvaluation(
        asset_key=dg.AssetKey(asset),
        check_name=CHECK,
        passed=not stale,
        severity=dg.AssetCheckSeverity.WARN,
        description=found if stale else "all partitions were made from the present inputs",
        metadata={},
    )


def _check(asset: str) -> dg.AssetChecksDefinition:
    @dg.asset_check(
        asset=asset,
        name=CHECK,
        description="Every partition was made from the present versions of its inputs. A failure is a warning that "
        "names the partitions to materialize again. The sensor stale_partitions evaluates it when an input changes.",
    )
    def made_from_present_inputs(context: dg.AssetCheckExecutionContext) -> dg.AssetCheckResult:
        found = evaluation(context.instance, asset)
        return dg.AssetCheckResult(passed=found.passed, severity=found.severity, description=found.description)

    return made_from_present_inputs


CHECKS = [_check(asset) for asset in CHECKED]
