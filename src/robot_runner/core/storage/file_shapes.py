"""The shapes of the JSON files of an experiment's folder, on which their readers rely.

Files of earlier versions stay valid, so a key is required only where every version has written it.
"""

# Without `from __future__ import annotations`: a TypedDict would not see which of its keys are required.
from typing import Any, NotRequired, TypedDict

from robot_runner.core.storage.declared_shapes import Moment, Scalar, Seed

# manifest.json


class _Config(TypedDict):
    file: NotRequired[str | None]


class _Batch(TypedDict):
    batch: int
    runs: NotRequired[int]
    defaults: NotRequired[dict[str, Any]]
    shuffle: NotRequired[bool]
    blocks: NotRequired[str | None]
    seed: NotRequired[Seed | None]


class _Design(TypedDict):
    source: NotRequired[str]
    factors: NotRequired[dict[str, list[str]]]
    ranges: NotRequired[dict[str, str]]
    repetitions: NotRequired[int]
    shuffle: NotRequired[bool]
    blocks: NotRequired[str | None]
    batches: NotRequired[list[_Batch]]
    is_reordered: NotRequired[bool]
    accepted_plan: NotRequired[str]


class Repository(TypedDict):
    """The state of a repository, as recorded at an execution."""

    commit: NotRequired[str | None]
    branch: NotRequired[str | None]
    origin: NotRequired[str | None]
    repository: NotRequired[str | None]
    is_dirty: NotRequired[bool | None]
    kept: NotRequired[str | None]


class _Execution(TypedDict):
    started_at: NotRequired[Moment]
    finished_at: NotRequired[Moment]
    deviations: NotRequired[dict[str, Scalar]]
    selection: NotRequired[dict[str, list[str]]]
    repository: NotRequired[Repository | None]
    changed: NotRequired[dict[str, "_Change"]]
    given: NotRequired[dict[str, Any]]
    changed_values: NotRequired[dict[str, dict[str, Any]]]
    config_number: NotRequired[int]


_Change = TypedDict("_Change", {"was": Scalar, "is": Scalar})

_Plugin = TypedDict(
    "_Plugin",
    {
        "name": NotRequired[str],
        "class": NotRequired[str | None],
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
    system: NotRequired[dict[str, Any] | None]
    system_packages: NotRequired[dict[str, str] | None]
    editable_code: NotRequired[dict[str, Any] | None]


_TableDeviation = TypedDict("_TableDeviation", {"run": str, "column": str, "was": Scalar, "is": Scalar})


class _Machine(TypedDict):
    host: dict[str, Any]
    places: list[str]


class Manifest(TypedDict):
    """`manifest.json`."""

    format: int
    experiment_name: NotRequired[str]
    config: NotRequired[_Config | None]
    deviations: NotRequired[dict[str, Scalar]]
    robot: NotRequired[str | None]
    robots: NotRequired[dict[str, str | None] | None]
    ros: NotRequired[dict[str, Any] | None]
    design: NotRequired[_Design]
    seed: NotRequired[Seed]
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
    programs: NotRequired[dict[str, Any] | None]
    executions: NotRequired[list[_Execution]]
    given_to_extension: NotRequired[dict[str, Any] | None]
    clocks: NotRequired[dict[str, dict[str, Any]]]
    machines: NotRequired[list[_Machine]]
    revisions: NotRequired[dict[str, dict[str, Repository]]]
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


# The other files


class _RegisteredConfig(TypedDict):
    file: NotRequired[str | None]
    sha256: NotRequired[str | None]
    modules: NotRequired[dict[str, str] | None]
    settings: NotRequired[dict[str, Any] | None]


class RegistrationFile(TypedDict):
    """`registration.json`."""

    format: int
    registered_at: str
    experiment: str
    config: _RegisteredConfig
    design: dict[str, Any]
    seed: Seed
    measures: list[dict[str, Any]]
    analysis: dict[str, Any] | None
    power: dict[str, Any] | None
    sha256: str


class HolderFile(TypedDict):
    """The holder of the lock of an experiment's folder."""

    pid: int
    host: str
    since: str


class RequestFile(TypedDict):
    """A request of a second terminal to the orchestrator."""

    command: str
    answers: NotRequired[dict[str, str]]
    run: NotRequired[str]
    step: NotRequired[str]


class ClaimFile(TypedDict):
    """The holder of a claim against other experiments of the user."""

    experiment: str
    folder: str
    pid: int
    since: str
    before: NotRequired[list[str]]
    machine: NotRequired[str]


class QueuedFile(TypedDict):
    """An experiment in the queue."""

    config: str
    options: list[str]
    started_in: str
    experiment: str
    results: str
    claims: list[str]
    python: str
    environment: dict[str, str]
    config_sha256: str
    added_at: Moment
    began_at: Moment | None
    ended_at: Moment | None
    exit_code: int | None
    problem: str
