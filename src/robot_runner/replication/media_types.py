"""What kind of file each is: its media type, and where the format is described (PRONOM where it has an entry)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath

__all__ = ["MediaType", "media_type_of"]

_PRONOM = "https://www.nationalarchives.gov.uk/PRONOM/"


@dataclass(frozen=True, slots=True)
class MediaType:
    """One kind of file.

    Attributes:
        name: the media type (RFC 6838).
        title: in words.
        page: where the format is described.

    Example:
        >>> media_type_of("runs/r_1/PsUtil/samples.csv").name
        'text/csv'
    """

    name: str
    title: str
    page: str


_ANY = MediaType("application/octet-stream", "Binary data", "https://www.rfc-editor.org/rfc/rfc2046#section-4.5.1")
_TEXT = MediaType("text/plain", "Plain text", f"{_PRONOM}x-fmt/111")
_BY_SUFFIX = {
    ".csv": MediaType("text/csv", "Comma separated values", f"{_PRONOM}x-fmt/18"),
    ".html": MediaType("text/html", "HTML 5", f"{_PRONOM}fmt/471"),
    ".json": MediaType("application/json", "JSON", f"{_PRONOM}fmt/817"),
    ".jsonl": MediaType("application/jsonl", "JSON lines", "https://jsonlines.org"),
    ".log": _TEXT,
    ".mcap": MediaType("application/octet-stream", "MCAP", "https://mcap.dev/spec"),
    ".md": MediaType("text/markdown", "Markdown", f"{_PRONOM}fmt/1149"),
    ".parquet": MediaType("application/vnd.apache.parquet", "Apache Parquet", f"{_PRONOM}fmt/1843"),
    ".pdf": MediaType("application/pdf", "PDF", f"{_PRONOM}fmt/276"),
    ".png": MediaType("image/png", "PNG", f"{_PRONOM}fmt/11"),
    ".py": MediaType("text/x-python", "Python", f"{_PRONOM}fmt/938"),
    ".svg": MediaType("image/svg+xml", "SVG", f"{_PRONOM}fmt/92"),
    ".txt": _TEXT,
    ".whl": MediaType("application/zip", "Python wheel", "https://peps.python.org/pep-0427/"),
    ".yaml": MediaType("application/yaml", "YAML", f"{_PRONOM}fmt/818"),
    ".yml": MediaType("application/yaml", "YAML", f"{_PRONOM}fmt/818"),
}
_BY_NAME = {"Containerfile": _TEXT, "SHA256SUMS": _TEXT}


def media_type_of(name: str) -> MediaType:
    """Return the kind of a file, by its name."""
    path = PurePosixPath(name)
    return _BY_NAME.get(path.name) or _BY_SUFFIX.get(path.suffix.casefold(), _ANY)
