"""Experiments as Prometheus reads them: https://prometheus.io/docs/instrumenting/exposition_formats/."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

_RUNS = (("done", "done"), ("failed", "failed"), ("todo", "to do"))
_WORDS = ("running", "waiting", "paused", "stopped", "failed", "done")


def metrics_text(experiments: Sequence[Mapping[str, Any]], viewers: int) -> str:
    """Return the figures of experiments, as the index has them, and how many look at pages."""
    return "".join(f"{line}\n" for line in _lines(experiments, viewers))


def _lines(experiments: Sequence[Mapping[str, Any]], viewers: int) -> Iterator[str]:
    yield "# HELP robot_runner_runs Runs of an experiment, by how far they have come."
    yield "# TYPE robot_runner_runs gauge"
    for each in experiments:
        counts = each.get("counts") or {}
        for name, status in _RUNS:
            if name in counts:
                yield f"robot_runner_runs{{{_labels(each)},status={_quoted(status)}}} {counts[name]}"
    yield "# HELP robot_runner_state 1 for how an experiment stands, 0 for how it could."
    yield "# TYPE robot_runner_state gauge"
    for each in experiments:
        for word in _WORDS:
            yield f"robot_runner_state{{{_labels(each)},state={_quoted(word)}}} {int(each['word'] == word)}"
    yield "# HELP robot_runner_seconds_left How long the runs that are left take, as estimated last, s."
    yield "# TYPE robot_runner_seconds_left gauge"
    for each in experiments:
        if each.get("left") is not None:
            yield f"robot_runner_seconds_left{{{_labels(each)}}} {each['left']:.0f}"
    yield "# HELP robot_runner_viewers How many look at live pages of this server."
    yield "# TYPE robot_runner_viewers gauge"
    yield f"robot_runner_viewers {viewers}"


def _labels(experiment: Mapping[str, Any]) -> str:
    return f"experiment={_quoted(str(experiment['name']))},folder={_quoted(str(experiment['folder']))}"


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\r", " ")
    return f'"{escaped}"'
