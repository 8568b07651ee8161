"""The terminal log of a run: progress messages, started and finished steps, checks and errors."""

import logging
import sys

import dagster as dg
from dagster import DagsterEventType

_SHOWN = {
    DagsterEventType.STEP_START: "started",
    DagsterEventType.STEP_SUCCESS: "done",
    DagsterEventType.STEP_FAILURE: "FAILED",
    DagsterEventType.STEP_SKIPPED: "skipped",
}

_NOT_RUN = "Dependencies for step "
"""Dagster logs such a line for every step after a failed one; the cause would scroll out of sight."""


class _Console(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        meta = getattr(record, "dagster_meta", None) or {}
        event, step = meta.get("dagster_event"), meta.get("step_key") or ""
        if event is None:
            text = str(meta.get("orig_message", record.getMessage()))
            if record.levelno < logging.INFO or text.startswith(_NOT_RUN):
                return
        elif (kind := event.event_type) in _SHOWN:
            step, text = event.step_key or "", _SHOWN[kind]
            if kind == DagsterEventType.STEP_FAILURE and event.step_failure_data.error:
                error = event.step_failure_data.error
                text += f": {(error.cause or error).message.strip()}"
        elif kind == DagsterEventType.ASSET_CHECK_EVALUATION:
            evaluation = event.asset_check_evaluation_data
            outcome = "passed" if evaluation.passed else "NOT PASSED"
            text = f"check {evaluation.check_name} {outcome}: {evaluation.description or 'no description'}"
        else:
            return
        time_of_day = self.formatter.formatTime(record, "%H:%M:%S") if self.formatter else ""
        print(f"{time_of_day}  {step:<20} {text}", file=sys.stderr, flush=True)


@dg.logger
def progress_console(context: dg.InitLoggerContext) -> logging.Logger:
    """Print one line per message, step event and check."""
    logger = logging.Logger("deltasafe", level=logging.DEBUG)  # Dagster logs all events but failures at this level
    handler = _Console()
    handler.setFormatter(logging.Formatter())
    logger.addHandler(handler)
    return logger
