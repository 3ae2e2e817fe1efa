"""What a crate must have, checked before a package is kept: a crate that is not valid is refused, never published.

The REQUIRED rules of RO-Crate 1.1, Process Run Crate and Workflow Run Crate (0.5) that an experiment could break. The
tests of the project ask the validator of the formats' own authors for all of them.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from datetime import datetime
from typing import Any
from urllib.parse import unquote

from robot_runner.core.errors import Finding
from robot_runner.replication.contents import CRATE

_FIX = "Report this: what packing writes is not what RO-Crate asks for."
_ACTIONS = frozenset({"CreateAction", "ActivateAction", "UpdateAction"})
_WORKFLOW = frozenset({"File", "SoftwareSourceCode", "ComputationalWorkflow"})


def crate_faults(text: str, names: Collection[str]) -> Iterator[Finding]:
    """Yield an error finding for each rule that the crate breaks.

    Args:
        text: of `ro-crate-metadata.json`.
        names: the files and folders of the package; those of folders end with `/`.

    Example:
        >>> text = '{"@graph": [{"@id": "./", "@type": "Dataset", "name": "naps"}]}'
        >>> [finding.problem for finding in crate_faults(text, [])][0]
        'the package has no description'
    """
    graph: dict[str, Mapping[str, Any]] = {str(each["@id"]): each for each in json.loads(text)["@graph"]}
    problems = (
        *_root_problems(graph),
        *_file_problems(graph, set(names)),
        *_reference_problems(graph),
        *_action_problems(graph),
    )
    yield from (Finding.error(CRATE, problem, _FIX) for problem in problems)


def _root_problems(graph: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    root = graph["./"]
    for name in ("name", "description", "datePublished", "license"):
        if not root.get(name):
            yield f"the package has no {name}"
    try:
        datetime.fromisoformat(str(root.get("datePublished")))
    except ValueError:
        yield f"datePublished is {root.get('datePublished')!r}, no date of ISO 8601"


def _file_problems(graph: Mapping[str, Mapping[str, Any]], names: set[str]) -> Iterator[str]:
    described = {unquote(key) for key, each in graph.items() if {"File", "Dataset"} & _types(each)} - {"./"}
    for name in sorted(described - names):
        yield f"{name} is described, and is not in the package"
    for name in sorted(each for each in names - described - {CRATE} if not each.endswith("/")):
        yield f"{name} is in the package, and is not described"


def _reference_problems(graph: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    for key, each in graph.items():
        for name, value in each.items():
            for part in value if isinstance(value, list) else [value]:
                other = part.get("@id") if isinstance(part, dict) else None
                if other and "://" not in other and other not in graph:
                    yield f"{name} of {key} names {other}, which nothing describes"


def _action_problems(graph: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    actions = [each for each in graph.values() if _ACTIONS & _types(each)]
    instruments = {(each.get("instrument") or {}).get("@id") for each in actions}
    if not actions or None in instruments:
        yield "an action has no instrument" if actions else "nothing says what was executed"
    main = graph["./"].get("mainEntity")
    if main and not (main["@id"] in instruments and _types(graph.get(main["@id"], {})) >= _WORKFLOW):
        yield f"no action says that {main['@id']} was executed as a workflow"


def _types(entity: Mapping[str, Any]) -> set[str]:
    kinds = entity.get("@type", [])
    return {kinds} if isinstance(kinds, str) else set(kinds)
