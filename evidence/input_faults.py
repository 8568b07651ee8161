"""Count the faults of data, labels, artifact and consumers that are repaired: each has tests that fail without it."""

import sys

from evidence.operation import fixed_faults
from evidence.reporting import command_parser, finish

_D, _I = "tests/unit/perception/data", "tests/unit/perception/inference/test_backend_sharing.py"
_FROZEN, _ONNX = (f"tests/unit/perception/artifact/test_{name}.py" for name in ("frozen_ensemble", "onnx_export"))
_LABELED, _IMAGES = f"{_D}/test_labeled_images.py", "tests/unit/io/test_images.py"
_BACKGROUNDS, _AUGMENTATION, _MASKS = (f"{_D}/test_{name}.py" for name in ("backgrounds", "augmentation", "masks"))
FAULTS = {
    "A1": (f"{_I}::test_threads_get_predictions_of_their_own_images",),
    "A2": (
        f"{_ONNX}::test_program_agrees_with_torch_at_any_size",
        f"{_ONNX}::test_program_agrees_with_torch_at_common_sizes",
    ),
    "A3": (
        f"{_LABELED}::test_copies_within_a_set_are_found_and_refused_in_test_sets",
        f"{_D}/test_near_copies.py::test_a_changed_copy_is_found_with_its_original",
    ),
    "A4": (
        f"{_MASKS}::test_of_a_mask_and_its_inverse_one_is_suspected",
        f"{_D}/test_import_hands.py::test_the_loader_refuses_inverted_masks_until_confirmed",
    ),
    "A5": ("tests/unit/perception/calibration/test_images_without_hand.py::test_tables_alone_support_no_delta",),
    "A6": ("tests/examples/test_examples.py::test_onnxruntime_example_refuses_what_it_would_read_wrong",),
    "A7": (f"{_BACKGROUNDS}::test_ignored_and_hidden_files_among_backgrounds",),
    "A8": (f"{_AUGMENTATION}::test_second_hand_stays_in_image_and_mask",),
    "A9": (f"{_I}::test_forked_process_predicts",),
    "A10": (f"{_I}::test_copy_predicts_the_same_before_and_after_first_use",),
    "A11": (
        "tests/unit/perception/test_evaluate_and_freeze.py::"
        "test_large_images_are_scaled_down_with_bounded_memory_and_disk",
    ),
    "A12": (f"{_BACKGROUNDS}::test_large_backgrounds_are_reduced_and_few_stay_in_memory",),
    "A13": (f"{_AUGMENTATION}::test_hand_stays_in_the_image_whatever_the_aspect_ratio",),
    "A14": (
        f"{_IMAGES}::test_undefined_orientations_are_upright",
        f"{_BACKGROUNDS}::test_turned_background_is_upright",
        f"{_FROZEN}::test_predict_command_takes_a_turned_photograph",
        "tests/examples/test_examples.py::test_onnxruntime_example_reads_images_as_the_library_does",
    ),
    "A15": (f"{_LABELED}::test_images_without_a_hand_are_allowed_beside_others",),
    "A16": (f"{_LABELED}::test_name_that_is_not_utf8_is_refused",),
    "A17": (f"{_BACKGROUNDS}::test_tiny_background_is_refused",),
    "A18": (
        f"{_MASKS}::test_masks_of_all_kinds_give_the_same_pixels",
        f"{_MASKS}::test_soft_masks_need_a_threshold",
        f"{_MASKS}::test_dithered_masks_are_noticed_and_thin_ones_are_not",
        f"{_IMAGES}::test_messages_name_the_cause_of_unreadable_files",
        f"{_LABELED}::test_unicode_forms_of_a_name_are_one_name",
        "tests/unit/io/test_checksum_list.py::test_dialects_are_read",
        "tests/unit/perception/calibration/test_evaluation.py::test_fewer_images_than_folds_are_left_out_one_by_one",
        f"{_FROZEN}::test_renamed_folder_is_loaded_after_the_remedy_of_the_message",
    ),
    "A19": (
        f"{_FROZEN}::test_what_is_no_array_is_refused_as_documented",
        f"{_FROZEN}::test_devices_are_chosen_or_refused_by_name",
    ),
    "A20": (f"{_FROZEN}::test_predict_command_never_writes_over_its_inputs",),
    "A21": (
        f"{_MASKS}::test_masks_of_all_kinds_give_the_same_pixels",
        "tests/pipelines/automation/test_launch_check.py::test_defective_folders_end_the_run_before_its_first_step",
    ),
}
"""Faults that were found by trying public trouble on the product, each with the tests that fail without the repair."""


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.input_faults``; 1 if a test did not pass."""
    options = command_parser("input_faults", __doc__).parse_args(arguments)
    figures, failures = fixed_faults(FAULTS)
    return finish(options, figures, failures, tests=FAULTS)


if __name__ == "__main__":
    sys.exit(main())
