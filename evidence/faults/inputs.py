"""Reject malformed inputs: each one must raise a typed error that names the file and a remedy.

Every case is a valid input with one corruption. It is given to the library, and to the command that reads such an
input (``deltasafe verify``, ``predict``, ``export``, ``import``, ``camera locate``). The command must print one line,
no traceback, and exit with a nonzero status. Neither may leave output behind.

Inputs in the forms that people have them must be accepted, with the same pixels (`evidence.faults.welcome`).
"""

import collections
import pathlib
import shutil
import sys
import tempfile
from collections.abc import Sequence

import numpy as np

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DeltasafeError
from evidence.faults.malformed.cameras import bag_cases, camera_cases
from evidence.faults.malformed.ensembles import ensemble_cases
from evidence.faults.malformed.labels import label_cases
from evidence.faults.malformed.logs import log_cases
from evidence.faults.malformed.pictures import hand_cases, picture_cases
from evidence.faults.malformed.recordings import recording_cases
from evidence.faults.malformed.scenes import copied_scene, scene_cases
from evidence.faults.malformed.tasks import task_cases
from evidence.faults.rejection import Case, Failure, InputKind, check_rejection
from evidence.faults.welcome import image_kinds, wrong_welcomes
from evidence.fixtures import temporary_home, tiny_ensemble
from evidence.reporting import command_parser, finish, print_progress
from pipelines.home import DATASETS


def all_cases(home: pathlib.Path) -> list[Case]:
    """Create every malformed input from valid ones below ``home``."""
    frozen = tiny_ensemble(home / "ensemble")
    scene = copied_scene(home)
    return [
        *hand_cases(home),
        *picture_cases(home, frozen),
        *label_cases(home),
        *scene_cases(scene),
        *log_cases(home, scene),
        *bag_cases(home),
        *camera_cases(home),
        *recording_cases(home, home / "ensemble" / "member-0"),
        *task_cases(home),
        *ensemble_cases(frozen),
    ]


def check_all(cases: Sequence[Case], home: pathlib.Path, seed: int, progress: Progress = silent) -> list[Failure]:
    """Return what is wrong with the rejections of all cases."""
    found: list[Failure] = []
    for done, case in enumerate(cases, start=1):
        found += check_rejection(case, seed, home)
        progress(done, len(cases), case.kind.name)
    return found


def input_kinds(cases: Sequence[Case]) -> list[InputKind]:
    """Return the kinds of inputs that have a valid one; a task has none, because its cases hold poses, not files."""
    return list({case.kind.name: case.kind for case in cases if case.kind.name != "task"}.values())


def rejected_valid_inputs(cases: Sequence[Case], home: pathlib.Path) -> list[Failure]:
    """Return the valid inputs that are rejected; their corruptions would prove nothing."""
    found = []
    for kind in input_kinds(cases):
        with tempfile.TemporaryDirectory(dir=home) as out:
            try:
                kind.read(kind.valid, pathlib.Path(out))
            except DeltasafeError as error:
                found.append(Failure("untyped", f"{kind.name}: the valid input is rejected: {error}"))
    return found


def named_hands(home: pathlib.Path) -> pathlib.Path:
    """Copy the first three images of the packaged training set; the name of one is not ASCII."""
    folder = home / "named hands"
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True)
        paths = sorted((DATASETS / "hands" / "train" / part).iterdir())[:3]
        for path, stem in zip(paths, ("h\u00e4nd", "b", "c"), strict=True):
            shutil.copyfile(path, folder / part / f"{stem}{path.suffix}")
    return folder


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.inputs``."""
    options = command_parser("faults.inputs", __doc__, seeded=True).parse_args(arguments)
    with temporary_home() as home:
        cases = all_cases(home)
        failures = rejected_valid_inputs(cases, home)
        failures += check_all(cases, home, options.seed, print_progress(50))
        n_welcome, wrong = wrong_welcomes(home, named_hands(home))
    counts = collections.Counter(failure.kind for failure in failures)
    figures = {
        "bad_inputs": len(cases),
        "bad_inputs_untyped": counts["untyped"],
        "bad_inputs_unnamed": counts["unnamed"],
        "bad_inputs_left_output": counts["left"],
        "welcome_inputs": n_welcome,
        "welcome_inputs_wrong": len(wrong),
        "image_kinds": len(image_kinds(np.zeros((4, 4, 3), np.uint8))),
    }
    by_kind = dict(collections.Counter(case.kind.name for case in cases))
    return finish(options, figures, [*(failure.text for failure in failures), *wrong], by_kind=by_kind)


if __name__ == "__main__":
    sys.exit(main())
