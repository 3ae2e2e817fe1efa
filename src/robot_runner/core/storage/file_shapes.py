"""The shapes of the JSON files of an experiment's folder: what their readers rely on.

What a version wrote once stays valid, so a key is required only where every version has written it.
"""

# Without `from __future__ import annotations`: a TypedDict would not see which of its keys are required.
from typing import Any, NotRequired, TypedDict

from robot_runner.core.storage.declared_shapes import Moment, Scalar

__all__ = ["RECORDS", "HolderFile", "Manifest", "Record", "RegistrationFile", "RequestFile", "SampleQuality", "Schema"]


# manifest.json


class _Config(TypedDict):
    file: NotRequired[str | None]


class _Batch(TypedDict):
    batch: int
    runs: NotRequired[int]
    defaults: NotRequired[dict[str, Any]]
    shuffle: NotRequired[bool]
    blocks: NotRequired[str | None]
    seed: NotRequired[int | None]


class _Design(TypedDict):
    source: NotRequired[str]
    factors: NotRequired[dict[str, list[str]]]
    repetitions: NotRequired[int]
    shuffle: NotRequired[bool]
    blocks: NotRequired[str | None]
    batches: NotRequired[list[_Batch]]
    is_reordered: NotRequired[bool]


class _Repository(TypedDict):
    commit: NotRequired[str | None]
    branch: NotRequired[str | None]
    origin: NotRequired[str | None]
    repository: NotRequired[str | None]
    is_dirty: NotRequired[bool | None]


class _Execution(TypedDict):
    started_at: NotRequired[Moment]
    finished_at: NotRequired[Moment]
    deviations: NotRequired[dict[str, Scalar]]
    selection: NotRequired[dict[str, list[str]]]
    repository: NotRequired[_Repository | None]


_Plugin = TypedDict(
    "_Plugin",
    {
        "name": NotRequired[str],
        "class": NotRequired[str],
        "package": NotRequired[str | None],
        "version": NotRequired[str | None],
        "measures": NotRequired[list[str]],
    },
)


class _RegistrationFacts(TypedDict):
    file: NotRequired[str]
    registered_at: NotRequired[str]
    sha256: NotRequired[str]


class _Author(TypedDict):
    name: NotRequired[str]
    orcid: NotRequired[str | None]
    affiliation: NotRequired[str | None]
    affiliation_url: NotRequired[str | None]


class _Software(TypedDict):
    python: NotRequired[str]
    robot_runner: NotRequired[str]
    packages: NotRequired[dict[str, str]]


_TableDeviation = TypedDict("_TableDeviation", {"run": str, "column": str, "was": Scalar, "is": Scalar})


class Manifest(TypedDict):
    """`manifest.json`."""

    format: int
    experiment_name: NotRequired[str]
    config: NotRequired[_Config | None]
    deviations: NotRequired[dict[str, Scalar]]
    robot: NotRequired[str | None]
    ros: NotRequired[dict[str, Any] | None]
    design: NotRequired[_Design]
    seed: NotRequired[int]
    analysis: NotRequired[dict[str, Any] | None]
    analysis_changes: NotRequired[list[dict[str, Any]]]
    registration: NotRequired[_RegistrationFacts | None]
    registration_changes: NotRequired[list[dict[str, Any]]]
    repeat_until: NotRequired[dict[str, Any] | None]
    repeat_until_changes: NotRequired[list[dict[str, Any]]]
    authors: NotRequired[list[_Author]]
    licence: NotRequired[str | None]
    citation: NotRequired[str | None]
    replication: NotRequired[dict[str, Any] | None]
    plugins: NotRequired[list[_Plugin]]
    host: NotRequired[dict[str, Any] | None]
    software: NotRequired[_Software]
    executions: NotRequired[list[_Execution]]
    clocks: NotRequired[dict[str, dict[str, Any]]]
    revisions: NotRequired[dict[str, dict[str, _Repository]]]
    table_deviations: NotRequired[list[_TableDeviation]]


# run_table.schema.json


class Schema(TypedDict):
    """`run_table.schema.json`; `robot_runner.core.storage.table_schema` knows our own keys in it."""

    fields: list["SchemaField"]


SchemaField = TypedDict(
    "SchemaField",
    {
        "name": str,
        "type": NotRequired[str],
        "title": NotRequired[str],
        "description": NotRequired[str],
        "unit": NotRequired[str],
        "robot_runner:role": NotRequired[str],
        "robot_runner:owner": NotRequired[str],
        "robot_runner:origin": NotRequired[str | None],
        "robot_runner:column": NotRequired[str],
        "robot_runner:findings": NotRequired[list[str] | None],
        "robot_runner:doubts": NotRequired[dict[str, list[str]] | None],
    },
)


# journal.jsonl, a record a line


class Record(TypedDict):
    """A record of the journal, whatever its kind."""

    kind: str
    at: NotRequired[Moment]


class _Dated(Record):
    at: Moment


class _OfRun(_Dated):
    run: str
    attempt: int


class _AttemptStarted(_OfRun):
    combination: NotRequired[dict[str, str] | None]
    repetition: NotRequired[int | None]


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
    stamps: dict[str, str | None]
    is_last: NotRequired[bool]
    is_amended: NotRequired[bool]
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


class _Clock(_OfRun):
    owner: NotRequired[str]
    host: NotRequired[str]
    before: NotRequired[_Offset | None]
    after: NotRequired[_Offset | None]
    uncertainty: NotRequired[float | None]


class _Gate(_Dated):
    run: str
    attempt: int
    state: str
    condition: str
    seen: str | None
    seconds: float


class _Waited(Record):
    run: NotRequired[str]  # a host that was started anew is awaited between two runs
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
    seed: NotRequired[int | None]
    runs: NotRequired[int]
    design: NotRequired[str]
    factors: NotRequired[dict[str, list[str]]]
    repetitions: NotRequired[int]
    repository: NotRequired[_Repository | None]
    selection: NotRequired[dict[str, list[str]]]


class _Estimate(TypedDict):
    in_words: str


class _Judged(_Dated):
    precision: NotRequired[list[_Estimate]]


class _PlannedRun(TypedDict):
    run: str
    combination: dict[str, Any]
    repetition: int
    block: NotRequired[int | None]


class _Repeated(_Judged):
    repetition: int
    runs: list[_PlannedRun]
    base: NotRequired[dict[str, Any]]


class _Extended(_Dated):
    batch: int
    repetitions: int
    shuffle: bool
    seed: int
    factors: dict[str, list[Any]]
    runs: list[_PlannedRun]
    blocks: NotRequired[str | None]
    base: NotRequired[dict[str, Any]]
    chosen: NotRequired[dict[str, list[str]]]
    defaults: NotRequired[dict[str, str]]


class _Waiting(Record):
    next_run: NotRequired[str]
    step: NotRequired[str | None]
    questions: NotRequired[list[dict[str, Any]]]


class _Asked(Record):
    run: str
    step: str


class _OperatorStep(Record):
    run: str
    step: str
    treatments: dict[str, Scalar]
    answers: dict[str, Scalar]
    notes: dict[str, Scalar]


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


class _MissionStopped(_OfRun):
    owner: str
    reason: str


class _Prepared(Record):
    treatments: dict[str, Any]


#: By kind; a record of a kind that is not here is one of a later version, or nobody relies on it.
RECORDS: dict[str, Any] = {
    "asked": _Asked,
    "attempt_finished": _AttemptFinished,
    "attempt_started": _AttemptStarted,
    "bound": _Bound,
    "clock": _Clock,
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
    "mission_stopped": _MissionStopped,
    "operator_step": _OperatorStep,
    "prepared": _Prepared,
    "repeated": _Repeated,
    "subject": _Subject,
    "table_written": _TableWritten,
    "waited": _Waited,
    "waiting": _Waiting,
    "window": _Window,
}


# The other files


class RegistrationFile(TypedDict):
    """`registration.json`."""

    format: int
    registered_at: str
    experiment: str
    config: dict[str, Any]
    design: dict[str, Any]
    seed: int
    measures: list[dict[str, Any]]
    analysis: dict[str, Any] | None
    power: dict[str, Any] | None
    sha256: str


class HolderFile(TypedDict):
    """Who holds the lock of an experiment's folder."""

    pid: int
    host: str
    since: str


class RequestFile(TypedDict):
    """What a second terminal leaves for the orchestrator."""

    command: str
    answers: NotRequired[dict[str, str]]


class _SampleCounts(TypedDict):
    clock_uncertainty: NotRequired[float | None]


class SampleQuality(TypedDict):
    """`quality.json` beside the samples of a profiler."""

    samples: NotRequired[_SampleCounts]
