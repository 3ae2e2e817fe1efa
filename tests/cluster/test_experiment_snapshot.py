"""A config travels to workers as it stands on the disk."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robot_runner.cluster.experiment_snapshot import experiment_of, snapshot_of
from robot_runner.core.config.preparation import prepare_or_refuse

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

CONFIG = """\
from places_of_this_study import PLACES

from robot_runner import ExperimentConfig, Factor, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"

    def create_run_table(self):
        return RunTableModel([Factor("Place", PLACES)])
"""
PLACES = "# -*- coding: latin-1 -*-\nPLACES = ['Caf\N{LATIN SMALL LETTER E WITH ACUTE}', 'Lab']\n"


def test_a_module_in_another_encoding_travels_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "study.py").write_text(CONFIG, encoding="utf-8")
    neighbour = tmp_path / "places_of_this_study.py"
    neighbour.write_bytes(PLACES.encode("latin-1"))
    with own_modules():
        snapshot = json.loads(json.dumps(snapshot_of(prepare_or_refuse(tmp_path / "study.py", {}))))
    with own_modules():
        there = experiment_of(snapshot, tmp_path / "worker")
    assert (there.config_path.parent / neighbour.name).read_bytes() == neighbour.read_bytes()
    assert "Caf\N{LATIN SMALL LETTER E WITH ACUTE}" in next(iter(there.model.factors)).treatments


@contextmanager
def own_modules() -> Iterator[None]:
    """Forget the config's neighbour, as the process of a worker has none."""
    try:
        yield
    finally:
        sys.modules.pop("places_of_this_study", None)
