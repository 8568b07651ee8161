"""Show the decision about a new ensemble: a table on the page of `champion`, and a check with the reason."""

from typing import TYPE_CHECKING

import dagster as dg

if TYPE_CHECKING:
    from deltasafe.perception.artifact.promotion import PromotionDecision

NOT_WORSE = dg.AssetCheckSpec(
    "new_ensemble_is_not_worse",
    asset="champion",
    description="The new ensemble is not worse than the previous one on the same test images, and is now in use. A "
    "failure is a warning: the previous ensemble stays in use, for the reason given.",
)


def not_worse(verdict: "PromotionDecision") -> dg.AssetCheckResult:
    """Create the check result. A refused challenger is a warning, so that the run continues with the champion."""
    return dg.AssetCheckResult(
        check_name=NOT_WORSE.name,
        passed=verdict.promoted,
        severity=dg.AssetCheckSeverity.WARN,
        description=verdict.reason,
        metadata={f"upper bound of the loss, {loss.measure}": loss.bound for loss in verdict.losses},
    )


def verdict_table(verdict: "PromotionDecision") -> dg.MarkdownMetadataValue:
    """Show old and new scores, losses, and their margins."""
    outcome = "is now in use" if verdict.promoted else f"stays challenger; `{verdict.champion}` stays in use"
    lines = [f"`{verdict.challenger}` {outcome}: {verdict.reason}.", ""]
    if verdict.losses:
        lines += ["| | previous | new | loss | upper bound | margin |", "|---|---|---|---|---|---|"]
    for loss in verdict.losses:
        scores = f"{loss.old:.4f} | {loss.new:.4f}"
        lines.append(f"| {loss.measure} | {scores} | {loss.loss:+.2%} | {loss.bound:+.2%} | {loss.margin:.2%} |")
    return dg.MetadataValue.md("\n".join(lines))
