"""Measure a frozen ensemble on sets of photographs, which are not part of the project.

Each ``--set NAME=FOLDER`` is a labeled set as `deltasafe evaluate` takes it (images/, masks/, optionally ignore/).
Figures by set: pixel accuracy, mIoU with its interval, NLL, Brier score, missed part of the hand at delta = 0.05 (mean
and worst image), and the mean mIoU of single members.
"""

import pathlib
import sys
import tempfile

from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from deltasafe.perception.folder_evaluation import evaluate_folder, metrics
from evidence.reporting import command_parser, finish, named_folder
from pipelines.command_line import run_command

DELTA = 0.05


def main() -> int:
    """Evaluate the ensemble on each set, print the figures, and return the exit status."""
    parser = command_parser("photographs", __doc__)
    parser.add_argument("--ensemble", type=pathlib.Path, required=True, metavar="DIR", help="a frozen ensemble")
    parser.add_argument("--set", action="append", required=True, metavar="NAME=FOLDER", help="repeat for further sets")
    options = parser.parse_args()
    ensemble = load_ensemble(options.ensemble)
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as reports:
        for entry in options.set:
            name, folder = named_folder(entry)
            report = evaluate_folder(ensemble, folder, pathlib.Path(reports) / name, planning_delta=DELTA)
            interval, missed = report.final.predictor, metrics(report)["missed_at_delta"]
            print(f"{name}: {len(report.image_ids)} photographs", flush=True)
            found = {key: report.figures()[key] for key in ("pa", "miou", "nll", "bs")}
            found |= {"miou_low": interval.low.miou, "miou_high": interval.high.miou, "images": len(report.image_ids)}
            found |= {"missed": missed["mean"], "missed_worst": missed["worst"]}
            found |= {"miou_m1": report.member_mean.mean.miou}
            figures |= {f"{name}_{key}": round(float(value), 6) for key, value in found.items()}
    names = ", ".join(entry.partition("=")[0] for entry in options.set)
    command = f"python -m evidence.photographs --ensemble {options.ensemble.name} --set NAME=FOLDER (for {names})"
    return finish(options, figures, command=command, ensemble=ensemble.folder.name)


if __name__ == "__main__":
    sys.exit(run_command(main))
