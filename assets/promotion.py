"""How a decision about the ensemble in use is shown: as a table on the asset's page, and as a check with its reason."""

from typing import TYPE_CHECKING

import dagster as dg

if TYPE_CHECKING:
    from deltasafe.perception.artifact.promotion import Verdict

__all__ = ["NOT_WORSE", "not_worse", "verdict_table"]

NOT_WORSE = dg.AssetCheckSpec(
    "new_ensemble_is_not_worse",
    asset="champion",
    description="The ensemble that was frozen last is in use; otherwise the reason why the one before still is.",
)


def not_worse(verdict: "Verdict") -> dg.AssetCheckResult:
    """A warning and no error: a refused challenger is what the gate is for, and the chain goes on with the champion."""
    return dg.AssetCheckResult(
        check_name=NOT_WORSE.name,
        passed=verdict.promoted,
        severity=dg.AssetCheckSeverity.WARN,
        description=verdict.reason,
        metadata={f"upper bound of the loss, {loss.measure}": loss.bound for loss in verdict.losses},
    )


def verdict_table(verdict: "Verdict") -> dg.MarkdownMetadataValue:
    """Old and new scores, what is lost, and what may be lost."""
    outcome = "is in use now" if verdict.promoted else f"stays challenger; `{verdict.champion}` stays in use"
    lines = [f"`{verdict.challenger}` {outcome}: {verdict.reason}.", ""]
    if verdict.losses:
        lines += ["| | in use before | new | loss | upper bound | margin |", "|---|---|---|---|---|---|"]
    for loss in verdict.losses:
        scores = f"{loss.old:.4f} | {loss.new:.4f}"
        lines.append(f"| {loss.measure} | {scores} | {loss.loss:+.2%} | {loss.bound:+.2%} | {loss.margin:.2%} |")
    return dg.MetadataValue.md("\n".join(lines))
