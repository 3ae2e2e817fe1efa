"""The shapes of what a worker tells of an attempt: a message of another shape must not end the whole experiment."""

# Without `from __future__ import annotations`: a TypedDict would not see which of its keys are required.
from collections.abc import Iterator
from typing import Any, NotRequired, TypedDict

from robot_runner.core.events.measure import Origin
from robot_runner.core.storage.declared_shapes import Scalar, faults_of, parsed_json
from robot_runner.core.storage.record_shapes import RECORDS


class _Measure(TypedDict):
    name: str
    value: Scalar
    owner: str
    origin: str


class _Failure(TypedDict):
    problem: str
    event: str
    owner: str
    traceback: str


class _Read(TypedDict):
    factor: str
    owner: str


class _Ended(TypedDict):
    because: str
    is_interrupted: bool
    seconds: float
    files: NotRequired[int]


class _EndedWithFiles(_Ended):
    bytes: int
    list: int


class _Lost(TypedDict):
    lost: str
    is_certain: NotRequired[bool]
    is_unfit: NotRequired[bool]


#: Of records that the journal does not keep, or not as they are; those of the others are the journal's.
_SHAPES = RECORDS | {"measure": _Measure, "failure": _Failure, "read": _Read}
#: What the journal adds to a record.
_ADDED = {"run": "r_1", "attempt": 1, "at": "2026-01-31T12:00:00.250Z"}
_ORIGINS = frozenset(each.value for each in Origin)


def read_message(text: str) -> tuple[list[list[Any]], dict[str, Any] | None]:
    """Return the records of a message, each a kind and its fields, and how the attempt has ended, if it has.

    Raises:
        ValueError: it has another shape; the first fault is named.
    """
    try:
        told = parsed_json(text)
    except (TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    if (fault := next(_faults(told), None)) is not None:
        raise ValueError(fault)
    records, ended = told
    return records, ended


def _faults(told: Any) -> Iterator[str]:
    match told:
        case [list() as records, None | dict() as ended]:
            for record in records:
                yield from _faults_of_record(record)
            if ended is not None:
                has_files = bool(ended.get("files"))
                yield from faults_of(ended, _Lost if "lost" in ended else _EndedWithFiles if has_files else _Ended)
        case _:
            yield "it has no records, or no end"


def _faults_of_record(record: Any) -> Iterator[str]:
    match record:
        case [str(kind), dict(fields)]:
            if kind in _SHAPES:
                yield from faults_of({"kind": kind, **_ADDED, **fields}, _SHAPES[kind])
            if kind == "measure" and fields["origin"] not in _ORIGINS:
                yield f"origin is {fields['origin']!r}, of which there is none"
        case _:
            yield "a record has no kind, or no fields"
