"""Logs of live runs as MCAP: what each cycle received and decided, and the replay that decides again."""

import base64
import contextlib
import dataclasses
import math
import pathlib
import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.geometry import Pose
from deltasafe.interchange.log_content import NS_PER_S
from deltasafe.interchange.mcap_log import LogWriter, open_log
from deltasafe.interchange.reading import read_log
from deltasafe.io.records import from_json
from deltasafe.online.loop import Decision, Observation, OnlineLoop, Task
from deltasafe.online.settings import OnlineSettings
from deltasafe.planning import MotionSettings
from deltasafe.scene import Camera, FieldSettings

IMAGES, DECISIONS = "/online/p_occupied", "/online/decision"
FACTS = "deltasafe.online"

Array = NDArray[np.float64]
Note = Callable[[float, Observation | None, Array, Decision, Mapping[str, float]], None]


@contextlib.contextmanager
def record_run(destination: str | pathlib.Path, loop: OnlineLoop, now_s: float, seed: int) -> Iterator[Note]:
    """Write the log of a run; the yielded function takes each cycle's inputs, decision and timing.

    Args:
        now_s, seed: as the loop was made with.

    Raises:
        SettingsError: the destination does not end in .mcap, or the package mcap is not installed.
    """
    with open_log(destination) as log:
        task = loop.task
        camera = {name: _plain(value) for name, value in vars(task.camera).items()}
        facts = {
            "task": {
                "camera": camera,
                "table_z_m": task.table_z_m,
                "hand_height_m": task.hand_height_m,
                "start": task.start.as_tuple(),
                "goal": task.goal.as_tuple(),
            },
            "motion": dataclasses.asdict(loop.motion),
            "settings": dataclasses.asdict(loop.settings),
            "field": dataclasses.asdict(loop.field),
            "now_s": now_s,
            "seed": seed,
        }
        log.write_facts(FACTS, facts)
        yield lambda *cycle: _write_cycle(log, *cycle)


def _write_cycle(
    log: LogWriter,
    now_s: float,
    observation: Observation | None,
    tool_pose: Array,
    decision: Decision,
    timing_ms: Mapping[str, float],
) -> None:
    time_ns = max(0, round(now_s * NS_PER_S)) if math.isfinite(now_s) else 0
    if observation is not None:
        p = observation.p_occupied
        height, width = (0, 0) if p is None else p.shape
        data = b"" if p is None else zlib.compress(np.ascontiguousarray(p).tobytes(), 1)
        image = {"captured_s": _or_none(observation.captured_s), "defect": observation.defect}
        size = {"height": height, "width": width, "zlib": base64.b64encode(data).decode()}
        log.write_message(IMAGES, "deltasafe.OccupancyImage", time_ns, image | size)
    message = {
        "tool_pose": [_or_none(float(value)) for value in tool_pose],
        "has_image": observation is not None,
        **dataclasses.asdict(decision),
        "captured_s": _or_none(decision.captured_s),
        "timing_ms": {name: round(value, 3) for name, value in timing_ms.items()},
    }
    log.write_message(DECISIONS, "deltasafe.OnlineDecision", time_ns, message)


def replay(source: str | pathlib.Path) -> tuple[list[Decision], list[Decision]]:
    """Decide again from the images, poses and times of a log; return its decisions and the new ones.

    Raises:
        DataError: the log is damaged, or of another kind.
        SettingsError: the package mcap is not installed.
    """
    log = read_log(source)
    facts, cycles = log.facts_named(FACTS), log.messages_on(DECISIONS)
    images = iter(log.messages.get(IMAGES, []))
    logged: list[Decision] = []
    again: list[Decision] = []
    try:
        loop = _loop_of(facts)
        for cycle in cycles:
            observation = _observation(next(images)) if cycle["has_image"] else None
            pose = np.array([math.nan if value is None else value for value in cycle["tool_pose"]])
            values = {field.name: cycle[field.name] for field in dataclasses.fields(Decision)}
            logged.append(Decision(**{**values, "captured_s": _or_nan(values["captured_s"])}))
            again.append(loop.decide(cycle["now_s"], observation, pose))
    except (KeyError, TypeError, ValueError, StopIteration, zlib.error, SettingsError) as error:
        raise DataError(
            log.path, f"holds no live run that can be replayed ({error!r:.200}); record it again"
        ) from error
    return logged, again


def same(one: Decision, other: Decision) -> bool:
    """Whether two decisions are equal; NaN equals NaN."""
    return repr(one) == repr(other)


def _loop_of(facts: Mapping[str, Any]) -> OnlineLoop:
    task = dict(facts["task"])
    task |= {"camera": Camera.from_json(task["camera"]), "start": Pose(*task["start"]), "goal": Pose(*task["goal"])}
    motion, settings = from_json(MotionSettings, facts["motion"]), from_json(OnlineSettings, facts["settings"])
    field = from_json(FieldSettings, facts["field"])
    return OnlineLoop(Task(**task), _no_perception, motion, settings, facts["now_s"], facts["seed"], field)


def _no_perception(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    raise SettingsError("a replay uses the logged p_occupied; it has no perception")


def _observation(message: Mapping[str, Any]) -> Observation:
    captured_s, size = _or_nan(message["captured_s"]), (message["height"], message["width"])
    if 0 in size:
        return Observation(captured_s, None, message["defect"])
    data = zlib.decompress(base64.b64decode(message["zlib"], validate=True))
    return Observation(captured_s, np.frombuffer(data, np.uint8).reshape(size), message["defect"])


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
