"""What a Frictionless data package says of an experiment and its run table.

https://specs.frictionlessdata.io/data-package/
"""

from __future__ import annotations

import re
from typing import Any

__all__ = ["data_package", "file_resource", "table_resource"]


def data_package(experiment: str, resources: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the description of a data package with these resources."""
    return {
        "profile": "data-package",
        "name": _slug(experiment).strip("-") or "experiment",
        "title": experiment,
        "description": f"Results of the experiment {experiment}, executed with Robot Runner.",
        "resources": resources,
    }


def file_resource(path: str, size: int, sha256: str) -> dict[str, Any]:
    """Return what is said of any file.

    Args:
        path: below the folder of the data package, with `/`.
        size: in bytes.
        sha256: of its bytes, in hexadecimal digits.

    Example:
        >>> file_resource("runs.csv", 3, "00")["hash"]
        'sha256:00'
    """
    return {
        "name": _slug(path),
        "path": path,
        "format": path.rpartition(".")[2],
        "bytes": size,
        "hash": f"sha256:{sha256}",
    }


def table_resource(path: str, size: int, sha256: str, *, schema: str | None) -> dict[str, Any]:
    """Return what is said of a table in CSV; `schema` is the path of its Table Schema."""
    tabular = {"profile": "tabular-data-resource", "mediatype": "text/csv", "encoding": "utf-8"}
    return file_resource(path, size, sha256) | tabular | ({"schema": schema} if schema else {})


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9._-]+", "-", text.casefold())
