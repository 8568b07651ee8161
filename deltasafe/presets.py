"""Presets: the named settings of the whole pipeline, `smoke`, `default` and `paper`."""

import dataclasses
import os

from deltasafe.errors import SettingsError
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.perception.calibration.report import CalibrationSettings
from deltasafe.perception.data.augmentation.settings import AugmentationSettings
from deltasafe.perception.settings import (
    GateThresholds,
    InferenceSettings,
    NetworkSettings,
    PromotionSettings,
    TrainingSettings,
)
from deltasafe.planning import MotionSettings
from deltasafe.scene import FieldSettings
from deltasafe.setting_ranges import check_range
from deltasafe.studies.perception import StudySettings
from deltasafe.studies.planner.settings import ComparisonSettings, TimingSettings
from deltasafe.studies.safety.settings import SafetyStudySettings
from deltasafe.studies.tracking.settings import TrackingStudySettings

VARIABLE = "DELTASAFE_PRESET"
"""Environment variable that names the active preset."""


@dataclasses.dataclass(frozen=True)
class Preset:
    """Settings of the whole pipeline.

    Attributes:
        n_members: number of ensemble members M.
        n_scenes: number of logged scenes to plan and execute, in the order of their names; 0 means all.
        n_films: number of executions to film, smallest clearance first; failures are always filmed.
    """

    n_members: int = 5
    augmentation: AugmentationSettings = dataclasses.field(default_factory=AugmentationSettings)
    training: TrainingSettings = dataclasses.field(default_factory=TrainingSettings)
    inference: InferenceSettings = dataclasses.field(default_factory=InferenceSettings)
    calibration: CalibrationSettings = dataclasses.field(default_factory=CalibrationSettings)
    gate: GateThresholds = dataclasses.field(default_factory=GateThresholds)
    promotion: PromotionSettings = dataclasses.field(default_factory=PromotionSettings)
    study: StudySettings = dataclasses.field(default_factory=StudySettings)
    field: FieldSettings = dataclasses.field(default_factory=FieldSettings)
    motion: MotionSettings = dataclasses.field(default_factory=MotionSettings)
    execution: ExecutionSettings = dataclasses.field(default_factory=ExecutionSettings)
    comparison: ComparisonSettings = dataclasses.field(default_factory=ComparisonSettings)
    timing: TimingSettings = dataclasses.field(default_factory=TimingSettings)
    safety_study: SafetyStudySettings = dataclasses.field(default_factory=SafetyStudySettings)
    tracking_study: TrackingStudySettings = dataclasses.field(default_factory=TrackingStudySettings)
    n_scenes: int = 0
    n_films: int = 3

    def __post_init__(self) -> None:
        check_range(self, "[1, inf)", "n_members")
        check_range(self, "[0, inf)", "n_scenes", "n_films")


PRESETS = {
    # seconds; only checks that the pipeline runs: the model is undertrained, so the gate accepts everything
    "smoke": Preset(
        n_members=2,
        augmentation=AugmentationSettings(n_variants=2, width=96, height=72),
        training=TrainingSettings(NetworkSettings(pyramid_channels=32), epochs=3),
        inference=InferenceSettings(128, 96),
        calibration=CalibrationSettings(n_bootstrap=200, n_folds=5, planning_delta=0.5),
        gate=GateThresholds(pixel_accuracy=0.0, miou=0.0),
        study=StudySettings(
            sizes=(50, 100), n_members=2, n_members_most=3, n_members_ablation=1, left_out=("background",)
        ),
        motion=MotionSettings(delta=0.5),
        comparison=ComparisonSettings(n_levels=2, n_runs=3, n_runs_reference=2, n_iterations=500, voxel_m=0.01),
        timing=TimingSettings(counts=(1, 5, 20), n_runs=2, n_iterations=500, voxel_m=0.01),
        safety_study=SafetyStudySettings(deltas=(0.05, 0.45), n_executions=2, n_films=1),
        tracking_study=TrackingStudySettings(
            n_slope_runs=4, n_bound_runs=7, n_held_out_runs=5, runs_per_batch=4, content=0.7, confidence=0.9
        ),
        n_scenes=2,
        n_films=1,
    ),
    # about half an hour on two cores
    "default": Preset(study=StudySettings(comparison_width=160, comparison_epochs=2)),
    # the paper's network, image size, training recipe (decision 6) and M = 10; needs a GPU
    "paper": Preset(
        n_members=10,
        augmentation=AugmentationSettings(width=384, height=288, supersampling=1),
        training=TrainingSettings(
            NetworkSettings("deeplabv3", "resnet50", pyramid_channels=256),
            epochs=3,
            batch_size=2,
            peak_learning_rate=2e-4,
            schedule="exponential",
            epoch_decay=0.8,
            weight_decay=0.0,
            precision="float32",
        ),
        inference=InferenceSettings(384, 288, scales=(1.0,)),
    ),
}
"""Presets by name."""


def active() -> Preset:
    """Return the preset named by `DELTASAFE_PRESET`; `default` if the variable is unset or empty.

    Raises:
        SettingsError: no preset has that name.
    """
    name = os.environ.get(VARIABLE) or "default"
    if name not in PRESETS:
        raise SettingsError(f"{VARIABLE}={name!r} is not a preset; choose one of {', '.join(PRESETS)}")
    return PRESETS[name]
