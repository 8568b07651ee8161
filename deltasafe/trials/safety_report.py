"""Safety report: outcome of every scene, and figures over all of them."""

import dataclasses
import pathlib

from deltasafe.execution.verdict import SafetyVerdict
from deltasafe.io.storage import read_json


@dataclasses.dataclass(frozen=True)
class SceneReport:
    """Outcome of one scene.

    Attributes:
        outcome: `executed`, or why not.
        verdict: None if the motion was not executed.
        cost, length_m, duration_s: of the planned motion; None without one. ``cost_squared_m2`` and ``area_m2`` are
            the costs of the same path by the paper's two cost functions.
        film: file name of the film beside the report; empty without one.
        margin_m: margin around the unsafe set that the motion was planned with; 0: none.
    """

    scene_id: str
    outcome: str
    verdict: SafetyVerdict | None
    cost: float | None
    cost_squared_m2: float | None
    area_m2: float | None
    length_m: float | None
    duration_s: float | None
    film: str = ""
    margin_m: float = 0.0


@dataclasses.dataclass(frozen=True)
class SafetyReport:
    """Outcomes of all scenes at one delta and one ``motion_alpha`` (0: planned without a margin)."""

    delta: float
    scenes: tuple[SceneReport, ...]
    motion_alpha: float = 0.0

    @property
    def verdicts(self) -> list[SafetyVerdict]:
        """Verdicts of the executed scenes."""
        return [scene.verdict for scene in self.scenes if scene.verdict is not None]

    def figures(self) -> dict[str, float | None]:
        """Return the figures over all executions by name; lengths in meters.

        ``scenes_judged`` counts executions beside a true hand; only they count in ``scenes_safe`` and ``contacts``,
        which is None if there are executions and none of them is judged. ``scenes_unsafe`` also counts executions
        without a true hand that failed for another reason.
        """
        verdicts = self.verdicts
        contacts = [verdict.contacts for verdict in verdicts if verdict.contacts is not None]
        found: dict[str, float | None] = {
            "scenes": len(self.scenes),
            "scenes_executed": len(verdicts),
            "scenes_completed": sum(verdict.completed for verdict in verdicts),
            "scenes_judged": sum(verdict.hand_judged for verdict in verdicts),
            "scenes_safe": sum(verdict.safe is True for verdict in verdicts),
            "scenes_unsafe": sum(verdict.safe is False for verdict in verdicts),
            "contacts": sum(contacts) if contacts or not verdicts else None,
        }
        if verdicts:
            poses = sum(verdict.poses for verdict in verdicts)
            safe = sum(verdict.delta_safe_share * verdict.poses for verdict in verdicts)
            tool = [v.min_tool_to_hand_m for v in verdicts if v.min_tool_to_hand_m is not None]
            arm = [v.min_arm_to_hand_m for v in verdicts if v.min_arm_to_hand_m is not None]
            found |= {
                "delta_safe_pose_share": safe / poses,
                "motions_wholly_delta_safe": sum(
                    verdict.whole_motion_delta_safe and verdict.completed for verdict in verdicts
                ),
                "tracking_share_within_bound": sum(v.share_within_bound * v.poses for v in verdicts) / poses,
                "max_tracking_error_m": max(verdict.max_error_m for verdict in verdicts),
                "max_tracking_excess_m": max(verdict.max_excess_m for verdict in verdicts),
                **({"min_tool_to_hand_m": min(tool)} if tool else {}),
                **({"min_arm_to_hand_m": min(arm)} if arm else {}),
                **self._margin_figures(),
            }
        return found

    def _margin_figures(self) -> dict[str, float]:
        """Figures of the margin; empty without one."""
        if not self.motion_alpha:
            return {}
        kept = sum(verdict.margin_kept_share == 1.0 for verdict in self.verdicts)
        return {"motion_alpha": self.motion_alpha, "motions_that_kept_the_margin": kept}


def read_figures(folder: str | pathlib.Path) -> dict[str, float | None]:
    """Load the figures of the report in ``folder``; None: not judged.

    Raises:
        DataError: ``folder`` holds no report.
    """
    return dict(read_json(pathlib.Path(folder) / "report.json")["figures"])
