"""The states and the power of a robot in the runs of an experiment, read for a power model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_runner.core.errors import AnalysisError
from robot_runner.core.events.window import Window
from robot_runner.core.storage.guarded_files import MissingFileError, read_json
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.measuring.quality import MINIMUM_COVERAGE
from robot_runner.measuring.series import Series, cut, mean
from robot_runner.meters.power_model.states import RobotState, Sources, read_numbers, read_states

#: A piece shorter than this, s, holds too few samples of a 200 Hz meter for its mean power to mean much.
_SHORTEST = 0.02


@dataclass(frozen=True, slots=True)
class MeasuredRun:
    """The states and the power of the robot in a run.

    Attributes:
        run_id: the run's.
        states: of the robot, piece by piece.
        watts: the mean power of each piece, W.
        is_simulated: whether the meter was a simulated one.
    """

    run_id: str
    states: Sequence[RobotState]
    watts: Sequence[float]
    is_simulated: bool


def read_runs(
    experiment: Path, power: str, sources: Sources, run_ids: Sequence[str]
) -> tuple[list[MeasuredRun], dict[str, str]]:
    """Return the runs with measured power, and for each other run why it is left out.

    Args:
        experiment: the experiment's folder.
        power: the plugin with `power_W` in `samples.csv`, and the measured window in `quality.json`.
        sources: the plugins with the states of the robot.
        run_ids: the runs to read, which are done.

    Raises:
        AnalysisError: no run can be used.
    """
    runs, left_out = [], {}
    for run_id in dict.fromkeys(run_ids):  # once each: otherwise a held-out run would also be in the fit
        try:
            runs.append(_read_run(ExperimentFolder(experiment).run(run_id), power, sources))
        except AnalysisError as error:
            left_out[run_id] = str(error.problem)
            first = error
    if not runs:
        if not left_out:
            fix = "Execute the experiment first, with a power meter among its plugins."
            raise AnalysisError("no run is done", where=str(experiment), fix=fix)
        raise AnalysisError(f"no run can be used: {first.problem}", where=first.where, fix=first.fix)
    return runs, left_out


def _read_run(folder: Path, meter: str, sources: Sources) -> MeasuredRun:
    quality = _read_quality(folder / meter / "quality.json")
    window = Window(**quality["window"])
    power = Series(*read_numbers(folder / meter / "samples.csv", ("time_s", "power_W")))
    states, means = [], []
    for state in read_states(folder, window, sources):
        watts = mean(cut(power, Window(state.start, state.end))) if state.seconds >= _SHORTEST else None
        if watts is not None:
            states.append(state)
            means.append(watts)
    return MeasuredRun(folder.name, states, means, bool(quality.get("is_simulated")))


def _read_quality(path: Path) -> dict[str, Any]:
    """Return the quality of the meter's samples; refuse those that do not cover the window."""
    fix = "Name another plugin that measures power, or execute the experiment with one."
    try:
        quality: dict[str, Any] = read_json(path)
        coverage = quality["samples"]["coverage"] if quality["window"] else 0.0
    except MissingFileError as error:
        raise AnalysisError("there is no such file", where=str(path), fix=fix) from error
    except (KeyError, TypeError) as error:
        problem = f"the file has no measured window: {error}"
        raise AnalysisError(problem, where=str(path), fix=fix) from error
    if coverage < MINIMUM_COVERAGE:
        problem = f"the power samples cover {coverage:.0f} % of the measured window"
        raise AnalysisError(problem, where=str(path), fix="Leave this run out.")
    return quality
