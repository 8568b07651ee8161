"""Malformed inputs, by the hundred: each must be refused with a typed error that names the file and what to do.

Every case is a sound input of which one thing was spoiled. It is given to the library, and to the command that reads
such input (``deltasafe verify``, ``predict``, ``export``, ``import``), which has to say so in one line, without a
traceback, and to end with a status that is not 0. Neither may leave anything behind.
"""

import collections
import pathlib
import shutil
import sys
import tempfile
from collections.abc import Sequence

from deltasafe.errors import DeltasafeError
from deltasafe.progress import Progress, silent
from evidence.faults.ensemble import tiny_ensemble
from evidence.faults.judging import Case, Failure, judge
from evidence.faults.malformed.ensembles import ensemble_cases
from evidence.faults.malformed.logs import log_cases
from evidence.faults.malformed.pictures import hand_cases, picture_cases
from evidence.faults.malformed.recordings import recording_cases
from evidence.faults.malformed.scenes import copied_scene, scene_cases
from evidence.faults.malformed.tasks import task_cases
from evidence.faults.reporting import conclude, parser, progress_every
from pipelines.home import DATASETS

__all__ = ["all_cases", "main", "refused_though_sound", "try_all"]


def all_cases(home: pathlib.Path, frozen: pathlib.Path | None = None) -> list[Case]:
    """Every malformed input, made from sound ones below ``home``."""
    if frozen is None:
        frozen = tiny_ensemble(home / "ensemble")
    member = next(frozen.parent.parent.glob("member*"))
    scene = copied_scene(home, DATASETS)
    return [
        *hand_cases(home, DATASETS),
        *picture_cases(home, DATASETS, frozen),
        *scene_cases(scene),
        *log_cases(home, scene),
        *recording_cases(home, member),
        *task_cases(home),
        *ensemble_cases(frozen),
    ]


def try_all(cases: Sequence[Case], home: pathlib.Path, seed: int, progress: Progress = silent) -> list[Failure]:
    """What is wrong with the refusals."""
    found: list[Failure] = []
    for done, case in enumerate(cases, start=1):
        found += judge(case, seed, home)
        progress(done, len(cases), case.door.name)
    return found


def refused_though_sound(cases: Sequence[Case], home: pathlib.Path) -> list[Failure]:
    """Sound inputs that are refused: of whom nothing can be learned. A task is in its cases alone."""
    found = []
    for door in {case.door.name: case.door for case in cases if case.door.name != "task"}.values():
        with tempfile.TemporaryDirectory(dir=home) as out:
            try:
                door.read(door.sound, pathlib.Path(out))
            except DeltasafeError as error:
                found.append(Failure("untyped", f"{door.name}: is refused although it is sound: {error}"))
    return found


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.inputs``."""
    options = parser(__doc__).parse_args(arguments)
    home = pathlib.Path(tempfile.mkdtemp(prefix="deltasafe-faults-"))
    home.chmod(0o755)
    try:
        cases = all_cases(home)
        failures = refused_though_sound(cases, home)
        failures += try_all(cases, home, options.seed, progress_every(50))
    finally:
        shutil.rmtree(home)
    kinds = collections.Counter(failure.kind for failure in failures)
    figures = {
        "bad_inputs": len(cases),
        "bad_inputs_untyped": kinds["untyped"],
        "bad_inputs_unnamed": kinds["unnamed"],
        "bad_inputs_left_output": kinds["left"],
    }
    by_kind = dict(collections.Counter(case.door.name for case in cases))
    return conclude("inputs", figures, options, [failure.words for failure in failures], by_kind=by_kind)


if __name__ == "__main__":
    sys.exit(main())
