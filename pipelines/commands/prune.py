"""Show what may be deleted from the home, and delete it with --delete."""

import argparse
import sys
from collections.abc import Sequence

from pipelines.command_line import run_command
from pipelines.home import prepare_home
from pipelines.retention import Deletable, Retention, RetentionSettings


def main(arguments: list[str] | None = None) -> int:
    """Print what is or would be deleted; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m pipelines.commands.prune", description=__doc__)
    parser.add_argument("--delete", action="store_true", help="delete; without it, only show")
    options = parser.parse_args(arguments)
    return run_command(lambda: _run(options.delete))


def _run(delete: bool) -> int:
    root, settings = prepare_home(), RetentionSettings.from_environment()

    import dagster as dg

    with dg.DagsterInstance.get() as instance:
        retention = Retention(root, instance, settings)
        found = retention.survey()
        _print(found)
        rows = retention.disk_use(found)
        if delete:
            retention.prune(found)
            rows = retention.disk_use([])
    print(f"\n{'MB':>10}  {'deletable':>10}  part of {root}")
    for row in rows:
        print(f"{row['MB']:>10.1f}  {row['deletable MB']:>10.1f}  {row['part']}")
    kept = f"the newest {settings.runs} runs and {settings.versions} versions, all from the last {settings.days:g} days"
    print(f"Kept: {kept} ($DELTASAFE_KEEP_RUNS, _VERSIONS, _DAYS), and what they refer to.")
    if found and not delete:
        print("Nothing was deleted. To delete this: make prune DELETE=1")
    return 0


def _print(found: Sequence[Deletable]) -> None:
    for each in found:
        print(f"{each.n_bytes / 1e6:>10.1f}  {each.part}: {each.name}")
    print(f"{sum(each.n_bytes for each in found) / 1e6:>10.1f}  MB in {len(found)} entries may be deleted")


if __name__ == "__main__":
    sys.exit(main())
