"""Which of the operator's steps were done, as the journal tells: that decides which ones are due."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from robot_runner.core.config.operator_steps import OperatorStep
from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import MeasureValue
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.words import enumerated

_PUT_BACK = "Put it back into the config, and start the experiment again, if it is still to be asked for."


@dataclass(slots=True)
class _Done:
    """When a step was done last.

    Attributes:
        treatments: which it was done for, by factor.
        begun_since: the runs that have begun since.
        ahead: those that came before it, and had not begun when it was done.
    """

    treatments: Mapping[str, str]
    begun_since: set[str] = field(default_factory=set)
    ahead: set[str] = field(default_factory=set)


def still_to_do(run_id: str, steps: Sequence[str]) -> Finding:
    """Return the finding that the person has not done yet what comes after a run."""
    problem = f"still to be done after it: {enumerated(steps)}"
    return Finding.warning(run_id, problem, "Start the experiment again: it asks for that first.")


class StepHistory:
    """Which steps were done, and what was answered about runs that have not come to their end.

    Attributes:
        answers: as above, by run.
        ends: how runs ended that are done, by run, where steps are still to be done after them (`to_ask`).
        after: the steps that come after runs in the config that was executed last.
    """

    def __init__(self) -> None:
        self._done: dict[str, _Done] = {}
        self.answers: dict[str, dict[str, MeasureValue]] = {}
        self.ends: dict[str, dict[str, Any]] = {}
        self.after: frozenset[str] = frozenset()

    @classmethod
    def of(cls, journal: Path) -> StepHistory:
        """Return what the journal tells."""
        history = cls()
        for record in read_journal(journal, kinds={"attempt_started", "attempt_finished", "operator_step"}):
            match record["kind"]:
                case "operator_step" if record.get("is_after"):
                    history.end_step(record["run"], record["step"])
                case "operator_step":
                    history.expect(record["step"], record["treatments"], record.get("ahead", ()))
                    history.take(record["run"], record["answers"])
                case "attempt_started":
                    history.begin(record["run"])
                case _ if record["is_last"]:
                    history.end(record["run"], is_interrupted=record["status"] == "interrupted")
                    history.expect_after(record)
        return history

    def expect(self, step: str, treatments: Mapping[str, str], ahead: Iterable[str]) -> None:
        """Take down that a step is done for some treatments, after runs that are yet to begin."""
        self._done[step] = _Done(treatments, ahead=set(ahead))

    def take(self, run_id: str, answers: Mapping[str, MeasureValue]) -> None:
        """Take down what was answered about a run."""
        self.answers.setdefault(run_id, {}).update(answers)

    def begin(self, run_id: str) -> None:
        """Take down that a run begins."""
        self.ends.pop(run_id, None)
        for done in self._done.values():
            if run_id not in done.ahead:
                done.begun_since.add(run_id)

    def expect_after(self, end: Mapping[str, Any]) -> None:
        """Take down which steps come after a run, by how it ended; a later end of the same attempt names none."""
        to_ask = end.get("to_ask") or self.ends.get(end["run"], {}).get("to_ask")
        if to_ask:
            self.ends[end["run"]] = {**end, "to_ask": to_ask}

    @property
    def left_after(self) -> list[Finding]:
        """What was not done after runs, and whether that is still to come."""
        found = []
        for run_id, end in self.ends.items():
            if left := [step for step in end["to_ask"] if step in self.after]:
                found.append(still_to_do(run_id, left))
            if gone := [step for step in end["to_ask"] if step not in self.after]:
                problem = f"was not done after it, and is no step of the config any more: {enumerated(gone)}"
                found.append(Finding.warning(run_id, problem, _PUT_BACK))
        return found

    def end_step(self, run_id: str, step: str) -> None:
        """Take down that a step was done after a run."""
        left = [each for each in self.ends.get(run_id, {}).get("to_ask", ()) if each != step]
        if left:
            self.ends[run_id]["to_ask"] = left
        else:
            self.ends.pop(run_id, None)

    def end(self, run_id: str, *, is_interrupted: bool) -> None:
        """Take down that a run has ended: if it is executed again, it begins anew, and is asked about anew."""
        for done in self._done.values():
            done.ahead.discard(run_id)
        if not is_interrupted:
            self.answers.pop(run_id, None)

    def ahead_of(self, step: str, yet_to_begin: Iterable[str]) -> list[str]:
        """Return which of some runs came before a step was done last."""
        return [run_id for run_id in yet_to_begin if run_id in self._done[step].ahead]

    def is_due(self, step: OperatorStep, treatments: Mapping[str, str]) -> bool:
        """Return whether a step is to be done before a run with these treatments of its factors."""
        done = self._done.get(step.name)
        if done is None or step.is_for_each_attempt:
            return True
        if step.every is not None:
            return len(done.begun_since) >= step.every
        return bool(step.factors) and done.treatments != treatments
