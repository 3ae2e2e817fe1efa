"""Inputs of an experiment as a package has them, on a machine that lacks the originals."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robot_runner.core.storage.input_files import copy_kept, kept_contents, kept_copies

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    import pytest

    from robot_runner.core.storage.input_files import InputFile


@contextmanager
def only_in_a_package(
    inputs: Iterable[InputFile], study: Path, beside: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Path]:
    """Keep inputs for a config in the folder `beside`, remove the study, and yield the folder of the working copies."""
    config = study.parent / "package" / "config"
    for place, content in kept_contents(list(inputs), beside, config).items():
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    shutil.rmtree(study)
    monkeypatch.chdir(config)
    copy_kept(config, working := study.parent / "working")
    with kept_copies(config, working):
        yield working
