"""The shapes of the journal's records, by kind, on which its readers rely.

Records of earlier versions stay valid, so a key is required only where every version has written it.
"""

# Without `from __future__ import annotations`: a TypedDict would not see which of its keys are required.
from typing import Any, NotRequired, TypedDict

from robot_runner.core.storage.declared_shapes import Moment, Scalar, Seed
from robot_runner.core.storage.file_shapes import Repository


class Record(TypedDict):
    """A record of the journal, whatever its kind."""

    kind: str
    at: NotRequired[Moment]


class _Dated(TypedDict):
    kind: str
    at: Moment


class _OfRun(_Dated):
    run: str
    attempt: int


class _AttemptStarted(_OfRun):
    combination: NotRequired[dict[str, str] | None]
    repetition: NotRequired[int | None]
    slot: NotRequired[int]


class _Measure(TypedDict):
    value: Scalar
    owner: str
    origin: str | None
    doubts: NotRequired[list[str]]


class _AttemptFinished(_OfRun):
    status: str
    seconds: float | None
    failure: str | None
    measures: dict[str, _Measure]
    doubts: NotRequired[dict[str, list[str]]]
    stamps: dict[str, str | None]
    is_last: NotRequired[bool]
    is_amended: NotRequired[bool]
    to_ask: NotRequired[list[str]]
    readers: NotRequired[dict[str, list[str]] | None]


class _Event(_Dated):
    event: str
    run: NotRequired[str]
    attempt: NotRequired[int]
    clock: NotRequired[float | None]


class _Finding(Record):
    run: NotRequired[str | None]
    attempt: NotRequired[int | None]
    owner: str
    problem: str
    fix: str


class _Window(_OfRun):
    start: float
    end: float


class _Offset(TypedDict):
    wall_offset: NotRequired[float | None]


class _Reading(TypedDict):
    wall_offset: float
    round_trip: float


class ClockFacts(TypedDict):
    """The offset of another computer's clock, which the manifest summarises."""

    host: str
    before: _Reading
    after: _Reading | None
    uncertainty: float
    drift: float | None


class _Clock(_OfRun):
    owner: NotRequired[str]
    host: NotRequired[str]
    before: NotRequired[_Offset | None]
    after: NotRequired[_Offset | None]
    uncertainty: NotRequired[float | None]


class _ClockSet(_Dated):
    seconds: float


class _Gate(_OfRun):
    state: str
    condition: str
    seen: str | None
    seconds: float


class _Waited(Record):
    run: NotRequired[str]  # absent where a host is awaited after its reboot, between two runs
    attempt: NotRequired[int]
    owner: NotRequired[str]
    condition: str
    seen: str | None
    seconds: float
    holds: bool


class _Guard(_OfRun):
    action: str
    problem: str


class _Excluded(_Dated):
    run: str
    reason: Scalar


class _Included(_Dated):
    run: str
    reason: NotRequired[Scalar]


_Deviation = TypedDict(
    "_Deviation", {"kind": str, "at": Moment, "run": str, "column": str, "was": Scalar, "is": Scalar}
)


class _TableWritten(Record):
    sha256: NotRequired[str | None]


class _ExperimentStarted(_Dated):
    pid: NotRequired[int]
    seed: NotRequired[Seed | None]
    runs: NotRequired[int]
    design: NotRequired[str]
    factors: NotRequired[dict[str, list[str]]]
    repetitions: NotRequired[int]
    repository: NotRequired[Repository | None]
    selection: NotRequired[dict[str, list[str]]]
    steps_after: NotRequired[list[str]]


class _Estimate(TypedDict):
    in_words: str


class _Judged(_Dated):
    precision: NotRequired[list[_Estimate]]
    why: NotRequired[str]
    known: NotRequired[dict[str, Any]]


class _PlannedRun(TypedDict):
    run: str
    combination: dict[str, Any]
    repetition: int
    block: NotRequired[int | None]


class _Repeated(_Judged):
    repetition: int
    runs: list[_PlannedRun]
    base: NotRequired[dict[str, Any]]


class _Decided(_Dated):
    name: str
    why: str
    runs: list[_PlannedRun]
    factors: NotRequired[dict[str, list[Any]]]
    base: NotRequired[dict[str, Any]]
    known: NotRequired[dict[str, Any]]


class _Extended(_Dated):
    batch: int
    repetitions: int
    shuffle: bool
    seed: Seed
    factors: dict[str, list[Any]]
    runs: list[_PlannedRun]
    blocks: NotRequired[str | None]
    base: NotRequired[dict[str, Any]]
    chosen: NotRequired[dict[str, list[str]]]
    defaults: NotRequired[dict[str, str]]
    role: NotRequired[str]
    why: NotRequired[str]
    known: NotRequired[dict[str, Any]]


class _Waiting(Record):
    next_run: NotRequired[str]
    place: NotRequired[str]
    step: NotRequired[str | None]
    is_after: NotRequired[bool]
    questions: NotRequired[list[dict[str, Any]]]


class _Asked(Record):
    run: str
    step: str


class _SetAside(Record):
    place: str
    problem: str


class _OperatorStep(Record):
    run: str
    step: str
    treatments: dict[str, Scalar]
    answers: dict[str, Scalar]
    notes: dict[str, Scalar]
    ahead: NotRequired[list[str]]
    is_after: NotRequired[bool]


class _BoundParameter(TypedDict):
    factor: str
    value: Any


class _Bound(_OfRun):
    owner: str
    parameters: dict[str, _BoundParameter]


class _Subject(_OfRun):
    owner: NotRequired[str]
    command: NotRequired[list[str]]
    host: NotRequired[str | None]
    output: NotRequired[str | None]


class _Machine(_OfRun):
    place: str
    host: dict[str, Any]


class _MissionStopped(_OfRun):
    owner: str
    reason: str


class _Prepared(Record):
    treatments: dict[str, Any]


#: By kind; a kind that is not here is of a later version, or has no reader.
RECORDS: dict[str, Any] = {
    "answered": _Asked,
    "asked": _Asked,
    "attempt_finished": _AttemptFinished,
    "attempt_started": _AttemptStarted,
    "bound": _Bound,
    "clock": _Clock,
    "clock_set": _ClockSet,
    "decided": _Decided,
    "deviation": _Deviation,
    "event": _Event,
    "excluded": _Excluded,
    "experiment_finished": _Dated,
    "experiment_started": _ExperimentStarted,
    "extended": _Extended,
    "finding": _Finding,
    "gate": _Gate,
    "guard": _Guard,
    "included": _Included,
    "judged": _Judged,
    "machine": _Machine,
    "mission_stopped": _MissionStopped,
    "operator_step": _OperatorStep,
    "prepared": _Prepared,
    "repeated": _Repeated,
    "set_aside": _SetAside,
    "stop_requested": _Dated,
    "subject": _Subject,
    "table_written": _TableWritten,
    "waited": _Waited,
    "waiting": _Waiting,
    "window": _Window,
}
