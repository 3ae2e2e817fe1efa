"""Has treatments made that need it, before the first run, and looks again at the plugins that are bound to them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.core.config.plugin_checks import check_plugins
from robot_runner.core.config.treatment_makers import Workshop, made_treatments
from robot_runner.core.design.revision import Revision
from robot_runner.core.errors import ExecutionError
from robot_runner.core.treatments import factors_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.design.factor import Factor
    from robot_runner.core.execution.interruption import Interruption

__all__ = ["describe_revisions", "prepared_treatments", "restore_revisions"]


def prepared_treatments(
    experiment: Experiment, known: Mapping[str, Any], interruption: Interruption, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Make the treatments of an experiment, and return plain facts of them.

    Args:
        experiment: whose they are; its treatments are changed in place.
        known: the facts that this returned when the experiment first began; a replication begins with the original's.
        interruption: the user's; it ends the making.
        tell: says on the screen what is being made.

    Raises:
        RobotRunnerError: one cannot be made, or a plugin cannot do with what was made.
        KeyboardInterrupt: the user has interrupted it.
    """
    known = known or (experiment.replication or {}).get("treatments", {})
    workshop = Workshop(experiment.folder.revisions, lambda: interruption.is_requested, tell)
    made = made_treatments(experiment.model.factors, known, workshop)
    if made:
        _refuse_unfit(experiment)
    return made


def _refuse_unfit(experiment: Experiment) -> None:
    """Ask plugins again that are bound to what was made: only now can they look into it."""
    names = {factor.name for factor in experiment.model.factors if any(map(_is_revision, factor.treatments))}
    bound = [each for each in experiment.plugins if names.intersection(factors_of(each).values())]
    found = check_plugins(bound, experiment.model, experiment.parameters.robot)
    errors = [finding for finding in found if finding.is_error]
    if errors:
        raise ExecutionError.of_findings(errors)


def _is_revision(treatment: object) -> bool:
    return isinstance(treatment, Revision)


# A fresh interpreter loads the config again: its revisions are told what this process knows of them.


def describe_revisions(factors: Sequence[Factor]) -> list[list[Any]]:
    """Return commit and path of each revision that was made, with its factor and its place there, as plain data."""
    return [
        [factor.name, place, each.commit, each.path]
        for factor in factors
        for place, each in enumerate(factor.treatments)
        if isinstance(each, Revision) and each.is_prepared
    ]


def restore_revisions(factors: Sequence[Factor], described: Sequence[Sequence[Any]]) -> None:
    """Tell revisions what `describe_revisions` returned of them."""
    by_name = {factor.name: factor for factor in factors}
    for name, place, commit, path in described:
        by_name[name].treatments[place].prepare(commit=commit, path=path)
