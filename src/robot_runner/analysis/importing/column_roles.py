"""Roles of the columns of another tool's run table: given by the user or guessed, with the confidence in each guess."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.importing.column_evidence import IN_RUN_ID, Confidence, Role, RoleGuess, repetition_number
from robot_runner.analysis.importing.column_verdicts import ColumnVerdicts
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.errors import AnalysisError, did_you_mean

if TYPE_CHECKING:
    from robot_runner.analysis.importing.description import ImportDescription
    from robot_runner.analysis.importing.foreign_table import ForeignTable

# As earlier tools, the paper's Fig. 3 and people write them; blanks, underscores, dots and case are ignored.
_RUN_ID = ("runid",)
_RUN_NAMES = ("id", "run", "runnumber", "runname", "runno", "nr", "no", "number", "index", "entryid", "experimentid")
_NUMBERING = (*_RUN_NAMES, "stdorder", "runorder")  # the last two are of design programs
_STATUS = ("done", "status", "progress", "state")
#: Headings of repetitions, the surest first; the values have to count, too.
_STEMS = "repetition|rep|repeat|replicate|replication|trial|iteration|iter|round|run|take|experiment"
_REPETITION = re.compile(rf"({_STEMS})(id|no|nr|num|number|index|idx)?")
_PLURALS = {"repetitions": "repetition", "reps": "rep", "repeats": "repeat", "trials": "trial"}
#: Earlier tools write columns of this name, so that the name alone decides.
_CERTAIN = "repetition"

# Headings of blocks, by which runs are grouped rather than compared. A few robots or rooms are a sample of their kind;
# a subject or a device is as often the object of the study.
_BLOCK = re.compile(r"(block|participant|person|operator|day|date|session|room|site|lab|robot|batch)s?(id|no|nr|name)?")
_SURE_BLOCK = re.compile(r"blocks?(id|no|nr|name)?")
_MAYBE_BLOCK = re.compile(r"(subject|device|host|machine|node|phone|website|app|vehicle|drone)s?(id|no|nr|name)?")
_NUMBERED_NAME = re.compile(
    r"(?:[a-z_ -]*[a-z_ -])?\d+|[a-z]|\d{4}-\d\d-\d\d|mon|tue|wed|thu|fri|sat|sun", re.IGNORECASE
)
_SEED = re.compile(r"(random|rng|sim|simulation|env)?seeds?")
_FEWEST_BLOCKS = 3


@dataclass(frozen=True, slots=True)
class ColumnRoles:
    """The roles of a run table's columns.

    Attributes:
        run_id: None where runs are to be numbered.
        status: None where a run counts as done if it has any measure.
        repetition: a column, or None.
        repetition_in_run_id: whether run ids end in `_repetition_0` and the like.
        block: the column of the blocks, or None; the repetition may be one, `Repetition` if run ids count it.
        factors, measures: columns in the order of the table.
        extras: columns that are kept unchanged.
        of_design: the columns of a design that the user declared: robots, periods, whole plots.
        guesses: the guessed role of each column, with its reason.
        notes: further notes for the user.
    """

    run_id: str | None
    status: str | None
    repetition: str | None
    repetition_in_run_id: bool
    block: str | None
    factors: tuple[str, ...]
    measures: tuple[str, ...]
    extras: tuple[str, ...]
    guesses: tuple[RoleGuess, ...]
    notes: tuple[str, ...]
    of_design: tuple[str, ...] = ()

    @property
    def design(self) -> tuple[str, ...]:
        """The columns of the design: factors, block, and the columns of a declared design."""
        blocks = [self.block] if self.block and not self.blocks_are_repetitions else []
        return tuple(dict.fromkeys((*self.factors, *blocks, *self.of_design)))

    @property
    def blocks_are_repetitions(self) -> bool:
        """Whether runs are compared within repetitions, which a column or the run ids count."""
        counted = self.repetition or (REPETITION if self.repetition_in_run_id else None)
        return self.block is not None and self.block == counted

    def repetition_of(self, run_id: str) -> int | None:
        """Return the number in a run id such as `run_3_repetition_1`."""
        found = IN_RUN_ID.match(run_id)
        return int(found[2]) if found and self.repetition_in_run_id else None

    @property
    def unsure(self) -> tuple[RoleGuess, ...]:
        """The guesses that need an answer."""
        return tuple(guess for guess in self.guesses if guess.confidence is Confidence.UNSURE)


def roles_of(table: ForeignTable, said: ImportDescription) -> ColumnRoles:
    """Find the role of each column; the user's words come first.

    Raises:
        AnalysisError: the user named a column that does not exist, or gave one two roles.
    """
    _check(table, said)
    return _Guessing(table, said).roles()


def _check(table: ForeignTable, said: ImportDescription) -> None:
    single = (said.run_id, said.status, said.repetition, said.block)
    designed = said.design.names if said.design is not None else ()
    of_factors = (*said.design.base, *said.design.ranges) if said.design is not None else ()
    computed = {recipe.measure for recipe in said.recipes}  # the table may lack these
    measures = {*(said.measures or ()), *said.units} - computed
    for name in filter(None, (*single, *(said.factors or ()), *measures, *said.ignore, *designed, *of_factors)):
        if name not in table.headings and (name, said.block) != (REPETITION, REPETITION):  # run ids may count these
            fix = did_you_mean(name, table.headings)
            raise AnalysisError(f"there is no column {name!r}", where=table.path.name, fix=fix)
    roles: dict[str, Sequence[str | None]] = {
        "factor": said.factors or (),
        "measure": said.measures or (),
        "ignored": said.ignore,
    }
    roles |= {"the run id": [said.run_id], "the status": [said.status], "the repetition": [said.repetition]}
    for name in table.headings:
        given = [role for role, names in roles.items() if name in names]
        given += ["the block"] if name == said.block and name != said.repetition else []
        given += ["part of the design"] if name in designed and name not in (said.factors or ()) else []
        if len(given) > 1:
            problem = f"column {name!r} is said to be {' and '.join(given)}"
            raise AnalysisError(problem, where=table.path.name, fix="Say one of the two.")


class _Guessing:
    """The state of one table's guessing: columns leave `left` as soon as their role is known."""

    def __init__(self, table: ForeignTable, said: ImportDescription) -> None:
        self._table = table
        self._said = said
        self._guesses: dict[str, RoleGuess] = {}
        self._evidence = ColumnVerdicts(table)
        self._notes: list[str] = []
        self._late: set[str] = set()

    def roles(self) -> ColumnRoles:
        said = self._said
        for role, names in ((Role.FACTOR, said.factors), (Role.MEASURE, said.measures)):
            for name in names or ():
                self._take(name, role, Confidence.SURE, "as you said")
        self._take_designed()
        run_id, status = self._run_id(), self._status()
        self._evidence.read_run_ids(run_id)
        if self._evidence.contradict_run_ids(run_id):
            example = self._evidence.values(str(run_id))[0]
            combinations = f"the combinations that {run_id} names ({example}, ...)"
            self._notes.append(f"no column agrees with {combinations}: these are not used")
        self._evidence.read_status(status)
        repetition = self._repetition()
        if said.block is not None and said.block != repetition and said.block in self._table.headings:
            self._take(said.block, Role.BLOCK, Confidence.SURE, "as you said")
        if said.guess or said.factors is None:
            self._guess_rest(repetition)
            repetition = self._checked_repetition(repetition)
            self._name_aliases()
        else:
            for name in self._left():
                is_measure = said.measures is None and self._evidence.is_measurable(name)
                role = Role.MEASURE if is_measure else Role.TEXT
                self._take(name, role, Confidence.SURE, "the description has no other")
        block = said.block or (self._guessed_block() if said.design is None else None)
        in_run_id = repetition is None and self._evidence.repetition_in_run_id
        if said.block is not None and said.block not in self._table.headings and not in_run_id:
            fix = "Say which column counts the repetitions: --block COLUMN."
            raise AnalysisError(f"there is no column {said.block!r}", where=self._table.path.name, fix=fix)
        named = {role: self._named(role) for role in Role}
        return ColumnRoles(
            run_id=run_id,
            status=status,
            repetition=repetition,
            repetition_in_run_id=in_run_id,
            block=block,
            factors=said.factors if said.factors is not None and not said.guess else named[Role.FACTOR],
            measures=named[Role.MEASURE],
            extras=named[Role.TEXT],
            guesses=tuple(self._guesses[name] for name in self._table.headings if name in self._guesses),
            notes=tuple(self._notes),
            of_design=said.design.names if said.design is not None else (),
        )

    def _take_designed(self) -> None:
        """Take the columns that the user's design names, also in a surface's ranges or a base, before guessing."""
        design = self._said.design
        if design is None:
            return
        roles = dict.fromkeys((*design.base, *design.ranges), Role.FACTOR) | dict.fromkeys(design.names, Role.BLOCK)
        for name, role in roles.items():
            if name not in self._guesses:
                self._take(name, role, Confidence.SURE, "your design names it")

    def _named(self, role: Role) -> tuple[str, ...]:
        return tuple(each for each in self._table.headings if (one := self._guesses.get(each)) and one.role is role)

    def _left(self) -> list[str]:
        return [name for name in self._table.headings if name not in self._guesses and name not in self._said.ignore]

    def _take(self, name: str, role: Role, confidence: Confidence, reason: str) -> str:
        self._guesses[name] = RoleGuess(name, role, confidence, reason)
        return name

    # The run's id, its status and the repetition are recognised by their headings and their values.

    def _run_id(self) -> str | None:
        if self._said.run_id:
            return self._take(self._said.run_id, Role.RUN_ID, Confidence.SURE, "as you said")
        evidence = self._evidence
        for name in self._called(_RUN_ID):
            if not evidence.is_empty(name):
                return self._take(name, Role.RUN_ID, Confidence.SURE, "its name")
        for name in self._called(_NUMBERING):
            if name != self._said.repetition and evidence.differs_everywhere(name):
                return self._take(name, Role.RUN_ID, Confidence.SURE, "its name, and no value twice")
        return self._counted_rows() if self._said.guess or self._said.factors is None else None

    def _counted_rows(self) -> str | None:
        """Take the first column for the run's id if it counts the rows, and treatments and a measure are behind it.

        Anywhere else numbers that grow one by one are as often measured, and in a table of numbers alone varied.
        """
        said, evidence, left = self._said, self._evidence, self._left()
        settled = (said.status, said.repetition, said.block)
        name = next((each for each in self._table.headings if each not in settled), "")
        if name not in left or _REPETITION.fullmatch(_folded(name)) or not evidence.counts_rows(name):
            return None
        texts = [each for each in left if evidence.is_treatment_text(each) and not self._table.has_answers(each)]
        if not (texts or said.factors) or not (said.measures or any(map(evidence.is_surely_measured, left))):
            return None
        told = f"{name} counts the rows and is taken for the run's id; if it was varied or measured"
        self._notes.append(f"{told}, say --factor or --measure {shlex.quote(name)}")
        return self._take(name, Role.RUN_ID, Confidence.LIKELY, "it counts the rows")

    def _status(self) -> str | None:
        if self._said.status:
            return self._take(self._said.status, Role.STATUS, Confidence.SURE, "as you said")
        for name in self._called(_STATUS):
            if name.startswith("__") or self._evidence.tells_status(name):
                return self._take(name, Role.STATUS, Confidence.SURE, "its name, and its words")
        return None

    def _called(self, names: Iterable[str]) -> list[str]:
        """Return the columns with one of the names, in the order of the names."""
        folded: dict[str, list[str]] = {}
        for name in self._left():
            folded.setdefault(_folded(name), []).append(name)
        return [name for each in names for name in folded.get(each, ())]

    def _repetition(self) -> str | None:
        if self._said.repetition:
            return self._take(self._said.repetition, Role.REPETITION, Confidence.SURE, "as you said")
        stems = _STEMS.split("|")
        found: list[tuple[int, int, str]] = []
        for place, name in enumerate(self._left()):
            match = _REPETITION.fullmatch(_PLURALS.get(_folded(name), _folded(name)))
            if match and (_folded(name) == _CERTAIN or self._evidence.may_count_repetitions(name)):
                found.append((stems.index(match[1]), place, name))
        if not found:
            return None
        name = min(found)[2]
        sure = Confidence.SURE if _folded(name).startswith("rep") else Confidence.LIKELY
        return self._take(name, Role.REPETITION, sure, "its name, and its numbers count")

    def _checked_repetition(self, repetition: str | None) -> str | None:
        """Return the column if it counts the runs of each combination; otherwise its role is guessed like any other."""
        if repetition is None or self._said.repetition or _folded(repetition) == _CERTAIN:
            return repetition
        factors = self._named(Role.FACTOR)
        is_one = not self._evidence.sums_up(repetition, factors)
        if is_one and self._evidence.tells_runs_apart(repetition, factors):
            reason = "its name, and it counts the runs of a combination"
            return self._take(repetition, Role.REPETITION, Confidence.SURE, reason)
        is_called = _folded(repetition).startswith(("rep", "trial"))
        if is_one and (self._evidence.crosses(repetition, factors) or is_called):
            reason = "its name, but runs of a combination have the same number"
            return self._take(repetition, Role.REPETITION, Confidence.UNSURE, reason)
        del self._guesses[repetition]
        self._guess_rest(None)
        return None

    # Factors, measures and text.

    def _guess_rest(self, repetition: str | None) -> None:
        evidence = self._evidence
        left = self._left()
        # Texts first: they tell the combinations, between whose repetitions numbers may differ.
        begun = min((place for place, name in enumerate(left) if evidence.is_surely_measured(name)), default=len(left))
        self._late = set(left[begun:])
        # Truth values after a measure may be outcomes, even if they are equally frequent.
        worded = [name for name in left if name not in self._late or not self._table.has_answers(name)]
        texts = [name for name in worded if evidence.is_treatment_text(name)]
        texts = [name for name in worded if name in texts or evidence.is_part_of(name, texts)]
        factors = [*self._named(Role.FACTOR), *texts]
        has_measures = False
        for place, name in enumerate(left):
            others = evidence.without_outcomes(name, factors)
            is_outcome = name in self._late and evidence.differs_between_repetitions(name, others, repetition)
            is_first = (place < begun and not has_measures) or (name in texts and not is_outcome)
            role, confidence, reason = self._evidence.verdict(name, factors, repetition, is_first=is_first)
            self._take(name, role, confidence, reason)
            # If run ids do not tell combinations, the first number that varies begins the measures.
            varies = len(evidence.values(name)) > 1 and not evidence.knows_combinations
            has_measures |= role is Role.MEASURE and confidence is not Confidence.UNSURE and varies
            if role is Role.FACTOR and name not in factors:
                factors.append(name)
            elif role is not Role.FACTOR and name in factors:
                factors.remove(name)
        if not any(len(evidence.values(name)) > 1 for name in self._named(Role.FACTOR)):
            self._take_only_text(texts or left)
        if repetition is None and not evidence.repetition_in_run_id:
            self._doubt_counts()

    def _take_only_text(self, names: Sequence[str]) -> None:
        """Take the first text as the factor where nothing repeats: a table with one run for each treatment."""
        for name in names:
            if self._guesses[name].role is Role.TEXT and self._evidence.could_be_only_factor(name):
                each = "each value has" if self._evidence.differs_everywhere(name) else "most values have"
                self._take(name, Role.FACTOR, Confidence.LIKELY, f"the one text of the table; {each} one run")
                return

    def _doubt_counts(self) -> None:
        """Ask about a factor of numbered texts with one run for each combination, which may count repetitions.

        Plain numbers are more often treatments, so they are only noted: the heading may say it in another language.
        """
        factors = self._named(Role.FACTOR)
        for name in factors:
            others = [each for each in factors if each != name]
            is_seed = _SEED.fullmatch(_folded(name)) and self._evidence.levels(name) > 1
            may_count = others and (is_seed or self._evidence.counts(name))
            if not may_count or not self._evidence.tells_runs_apart(name, others) or name in (self._said.factors or ()):
                continue
            numbers = sorted(self._evidence.values(name), key=lambda each: repetition_number(each) or 0)
            is_block = any(each.fullmatch(_folded(name)) for each in (_BLOCK, _MAYBE_BLOCK))
            if is_seed or not self._evidence.is_numeric(name):
                told = f"{'a seed' if is_seed else 'its texts are numbered'}, and each combination has every one once"
                reason = f"{told}: a repetition (--repetition), or one that treatments are compared within (--block)?"
                self._take(name, Role.FACTOR, Confidence.UNSURE, reason)
            elif len(numbers) >= _FEWEST_BLOCKS and not is_block:
                told = f"{name} counts from {numbers[0]} to {numbers[-1]}, and each combination has every number once"
                self._notes.append(f"{told}: repetitions? Then say --repetition {shlex.quote(name)}")

    def _name_aliases(self) -> None:
        """Take columns that follow from factors for what they are: mostly names of combinations and treatments."""
        factors = self._named(Role.FACTOR)
        free = [name for name in factors if name not in (self._said.factors or ())]
        for verdict in self._evidence.aliases(factors, free, self._late):
            self._take(*verdict)
        for name in self._named(Role.MEASURE):
            is_numbering = _folded(name) in _NUMBERING or _REPETITION.fullmatch(_folded(name))
            if is_numbering and self._evidence.follow(self._named(Role.FACTOR), name):
                self._take(name, Role.TEXT, Confidence.LIKELY, "it numbers the combinations")
            elif name not in (self._said.measures or ()) and (factor := self._evidence.unit_of(name, factors)):
                reason = f"each {name} has one {factor}, and its rows stand together: is {factor} tried on it?"
                self._take(name, Role.TEXT, Confidence.UNSURE, reason)

    # Blocks.

    def _block_by_name(self) -> str | None:
        """Return the column that is named block, if its blocks have several treatments."""
        said = (*(self._said.factors or ()), *(self._said.measures or ()))
        factors = [name for name in self._named(Role.FACTOR) if self._evidence.levels(name) > 1]
        for name in (*factors, *self._named(Role.MEASURE)):
            groups = 1 < self._evidence.levels(name) <= self._evidence.count // 2 and factors != [name]
            if _SURE_BLOCK.fullmatch(_folded(name)) and groups and name not in said and self._said.guess:
                return self._take(name, Role.BLOCK, Confidence.SURE, "its name")
        return None

    def _guessed_block(self) -> str | None:
        """Return the factor that is more likely a block; note others that may be one."""
        found = self._block_by_name()
        for name in self._named(Role.FACTOR):
            varied = [each for each in self._named(Role.FACTOR) if len(self._evidence.values(each)) > 1]
            others = [each for each in varied if each != name]
            likely, maybe = _BLOCK.fullmatch(_folded(name)), _MAYBE_BLOCK.fullmatch(_folded(name))
            values = self._evidence.values(name)
            is_free = (likely or maybe) and name not in (self._said.factors or ())
            crosses_all = self._evidence.crosses(name, others)
            crossed = [each for each in others if self._evidence.crosses(name, [each])]
            if not is_free or name not in varied or not crossed:
                continue
            is_numbered = crosses_all and all(map(_NUMBERED_NAME.fullmatch, values))
            if found is None and likely and is_numbered and len(values) >= _FEWEST_BLOCKS and self._said.guess:
                found = name
                reason = f"each of its {len(values)} values has every combination, and they are only numbered"
                self._take(name, Role.BLOCK, Confidence.LIKELY, reason)
                told = f"{name} is taken for a block"
                self._notes.append(f"{told}; if it is a treatment, say --factor {shlex.quote(name)}")
            else:
                told = f"{name} has every {'combination' if crosses_all else crossed[0]} for each of its values"
                self._notes.append(f"{told}: a block? Then say --block {shlex.quote(name)}")
        return found


def _folded(name: str) -> str:
    return re.sub(r"[\s_.#-]", "", name.casefold())
