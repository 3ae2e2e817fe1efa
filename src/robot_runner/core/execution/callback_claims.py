"""The claims of robots that callbacks of an experiment command by themselves, in the orchestrator and in its runs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cache

from robot_runner.core.config.claims import Claims, declared_for_callbacks, held_claims
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.parameters import RunProcess
from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.execution.going_on import goes_on
from robot_runner.core.execution.task import Report, RunTask
from robot_runner.core.links.robot_claims import RobotClaims


def callback_claims(
    experiment: Experiment,
    claimed: Callable[[], Collection[str]],
    tell: Callable[[Finding], object],
    *,
    is_run: bool = False,
) -> RobotClaims:
    """Return what takes the claims, with the parameters of `RobotClaims`."""
    return RobotClaims(
        experiment.parameters.experiment_name,
        experiment.folder.root,
        claimed=claimed,
        declared=declared_for_callbacks(experiment.parameters, experiment.events),
        goes_on=goes_on,
        tell=tell,
        is_run=is_run,
    )


def claims_of_run(experiment: Experiment, task: RunTask, report: Report) -> RobotClaims:
    """Return what takes them for a run; what the run itself has claimed is not in its way, unlike what others have."""

    @cache
    def claimed() -> frozenset[str]:
        parameters, plugins = experiment.parameters, experiment.plugins
        if parameters.run_process is RunProcess.IN_PROCESS:  # no other run is in flight
            return held_claims(Claims(parameters, plugins, experiment.events), experiment.model)
        at_place = Claims(parameters.but(robots={}), plugins, experiment.events)  # others that take turns have runs
        return at_place.of_run_against_others(task.combination, experiment.model)

    def tell(finding: Finding) -> None:
        report("finding", {"owner": CONFIG_OWNER, "problem": finding.problem, "fix": finding.fix})

    return callback_claims(experiment, claimed, tell, is_run=True)
