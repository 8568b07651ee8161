"""The terminal log shows steps, and why a check failed; it leaves out the steps that are not run for that reason."""

import dagster as dg

from pipelines.commands.console import progress_console


@dg.asset
def first(context: dg.AssetExecutionContext) -> int:
    context.log.debug("a detail")
    context.log.info("half done")
    return 1


@dg.asset_check(asset="first", blocking=True)
def large_enough() -> dg.AssetCheckResult:
    return dg.AssetCheckResult(passed=False, description="1 is less than 2")


@dg.asset
def second(first: int) -> int:
    return first


def test_a_failed_check_says_why_and_skipped_steps_add_no_lines(capfd):
    definitions = dg.Definitions([first, second], asset_checks=[large_enough], loggers={"console": progress_console})
    job = definitions.resolve_implicit_global_asset_job_def()
    with dg.DagsterInstance.ephemeral() as instance:
        config = {"loggers": {"console": {"config": {}}}}
        assert not job.execute_in_process(config, instance=instance, raise_on_error=False).success
    shown = [line.split(maxsplit=1)[1] for line in capfd.readouterr().err.splitlines()]
    assert [" ".join(line.split()) for line in shown[:4]] == [
        "first started",
        "first half done",
        "first done",
        "first_large_enough started",
    ]
    assert "check large_enough NOT PASSED: 1 is less than 2" in shown[4]
    assert not any("a detail" in line or "Not executing" in line for line in shown)
