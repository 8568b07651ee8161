"""Show and change the ensemble in use.

python -m pipelines.commands.registry list                            versions, newest first; what differs in Dagster
python -m pipelines.commands.registry promote VERSION --because TEXT  use a version
python -m pipelines.commands.registry rollback [--because TEXT]       use the previous version again
python -m pipelines.commands.registry replay                          send the MLflow calls that are pending
python -m pipelines.commands.registry retry                           send refused MLflow calls once more
"""

import argparse
import sys
from collections.abc import Sequence

from pipelines.addresses import masked
from pipelines.command_line import run_command
from pipelines.home import prepare_home, tracking_uri
from pipelines.tracking.model_versions import DEMOTED_TAG
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker, is_reachable

_DECISION_TAGS = ("promoted", "refused", DEMOTED_TAG)


def main(arguments: list[str] | None = None) -> int:
    """Run a command of the registry; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m pipelines.commands.registry", description=__doc__.partition("\n")[0]
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="list the versions, newest first, and what differs between MLflow and Dagster")
    promote = commands.add_parser("promote", help="use a version")
    promote.add_argument("version")
    promote.add_argument("--because", required=True, help="reason, stored with the version")
    rollback = commands.add_parser("rollback", help="use the previous version again")
    rollback.add_argument("--because", default="no reason given", help="reason, stored with the version")
    commands.add_parser("replay", help="send the MLflow calls that are pending")
    commands.add_parser("retry", help="send the MLflow calls that were refused once more, with those that are pending")
    options = parser.parse_args(arguments)
    return run_command(lambda: _run(options))


def _run(options: argparse.Namespace) -> int:
    import dagster as dg

    from pipelines.tracking.reconciliation import reconcile

    registry = EnsembleRegistry(MlflowTracker(prepare_home()))
    uri = tracking_uri(registry.tracker.home)
    if not is_reachable(uri):
        print(f"MLflow cannot be reached at {masked(uri)}; nothing was changed", file=sys.stderr)
        return 1
    if options.command == "retry":
        registry.tracker.pending.restore_refused()
    registry.tracker.replay()
    if options.command == "promote":
        registry.promote(options.version, options.because)
    elif options.command == "rollback":
        registry.rollback(options.because)
    with dg.DagsterInstance.get() as instance:
        differences = reconcile(registry, instance)
    _print(registry, differences)
    return 0


def _print(registry: EnsembleRegistry, differences: Sequence[str]) -> None:
    for version in registry.versions():
        decisions = [f"{tag.replace('_', ' ')}: {version.tags[tag]}" for tag in _DECISION_TAGS if tag in version.tags]
        aliases = ", ".join(sorted(version.aliases))
        print(f"{version.version:>4}  {aliases:<11} {version.tags.get('artifact', '?')}  {'; '.join(decisions)}")
    for difference in differences:
        print(difference)
    queue = registry.tracker.pending
    if pending := queue.files():
        print(f"{len(pending)} calls are pending in {queue.folder}; {registry.tracker.why_pending()}")
    for file, call, reason in queue.refused():
        print(f"refused call {file.name}: {call}: {reason}")
    if queue.refused():
        print("To send refused calls once more: python -m pipelines.commands.registry retry; to drop one, delete it.")


if __name__ == "__main__":
    sys.exit(main())
