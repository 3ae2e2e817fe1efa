"""Which of the operator's steps were done, by the journal, and so which ones are due."""

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
        treatments: for which it was done, by factor.
        begun_since: the runs that have begun since.
        ahead: earlier runs that had not begun when it was done; they do not count as begun since.
    """

    treatments: Mapping[str, str]
    begun_since: set[str] = field(default_factory=set)
    ahead: set[str] = field(default_factory=set)


def still_to_do(run_id: str, steps: Sequence[str]) -> Finding:
    """Return the finding that steps after a run have not been done yet."""
    problem = f"still to be done after it: {enumerated(steps)}"
    return Finding.warning(run_id, problem, "Start the experiment again: it asks for that first.")


class StepHistory:
    """Which steps were done, and the answers for runs that have not ended.

    Attributes:
        answers: by run.
        ends: the records of the end of runs after which steps are still to be done (`to_ask`), by run.
        after: the names of the steps after runs, in the config that was executed last.
    """

    def __init__(self) -> None:
        self._done: dict[str, _Done] = {}
        self.answers: dict[str, dict[str, MeasureValue]] = {}
        self.ends: dict[str, dict[str, Any]] = {}
        self.after: frozenset[str] = frozenset()

    @classmethod
    def of(cls, journal: Path) -> StepHistory:
        """Read it from a journal."""
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
        """Note that a step is done for these treatments; the runs `ahead` come before it and have not begun."""
        self._done[step] = _Done(treatments, ahead=set(ahead))

    def take(self, run_id: str, answers: Mapping[str, MeasureValue]) -> None:
        """Keep the answers about a run."""
        self.answers.setdefault(run_id, {}).update(answers)

    def begin(self, run_id: str) -> None:
        """Note that a run begins."""
        self.ends.pop(run_id, None)
        for done in self._done.values():
            if run_id not in done.ahead:
                done.begun_since.add(run_id)

    def expect_after(self, end: Mapping[str, Any]) -> None:
        """Keep which steps come after a run, by the record of its end; an amended record names none."""
        to_ask = end.get("to_ask") or self.ends.get(end["run"], {}).get("to_ask")
        if to_ask:
            self.ends[end["run"]] = {**end, "to_ask": to_ask}

    @property
    def left_after(self) -> list[Finding]:
        """Findings on steps after runs that were not done, and whether they will be asked for."""
        found = []
        for run_id, end in self.ends.items():
            if left := [step for step in end["to_ask"] if step in self.after]:
                found.append(still_to_do(run_id, left))
            if gone := [step for step in end["to_ask"] if step not in self.after]:
                problem = f"was not done after it, and is not a step of the config any more: {enumerated(gone)}"
                found.append(Finding.warning(run_id, problem, _PUT_BACK))
        return found

    def end_step(self, run_id: str, step: str) -> None:
        """Note that a step was done after a run."""
        left = [each for each in self.ends.get(run_id, {}).get("to_ask", ()) if each != step]
        if left:
            self.ends[run_id]["to_ask"] = left
        else:
            self.ends.pop(run_id, None)

    def end(self, run_id: str, *, is_interrupted: bool) -> None:
        """Note that a run has ended; unless it was interrupted, its answers are not for another attempt."""
        for done in self._done.values():
            done.ahead.discard(run_id)
        if not is_interrupted:
            self.answers.pop(run_id, None)

    def ahead_of(self, step: str, yet_to_begin: Iterable[str]) -> list[str]:
        """Return which of the runs `yet_to_begin` come before the step's last time."""
        return [run_id for run_id in yet_to_begin if run_id in self._done[step].ahead]

    def is_due(self, step: OperatorStep, treatments: Mapping[str, str]) -> bool:
        """Return whether a step is to be done before a run with these treatments of its factors."""
        done = self._done.get(step.name)
        if done is None or step.is_for_each_attempt:
            return True
        if step.every is not None:
            return len(done.begun_since) >= step.every
        return bool(step.factors) and done.treatments != treatments
