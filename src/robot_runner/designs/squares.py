"""Latin and Graeco-Latin squares: two or three kinds of blocks at once, each treatment once in each of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robot_runner.core.design.design import DesignedRuns, IsAllowed
from robot_runner.core.design.factor import Combination, Factor, full_factorial
from robot_runner.core.errors import Finding
from robot_runner.designs.choosing import Described
from robot_runner.designs.factor_roles import Roles, factor_name, refused, role_findings, shuffled, texts_of_combination
from robot_runner.designs.latin_squares import Square, has_orthogonal_pair, latin_square, orthogonal_pair


@dataclass(frozen=True, slots=True)
class LatinSquare(Described):
    """Each treatment once in each row and once in each column, such as each day and each robot.

    The other factors are studied: they have as many combinations as there are rows and columns. Each repetition is a
    square of its own. With `shuffle`, rows, columns and treatments are put into the square at random; the order of
    execution is that of the rows as written, and in each row that of the columns.

    Attributes:
        rows: the factor whose treatments are the rows.
        columns: the factor whose treatments are the columns.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> from robot_runner.core.design.run_table_model import RunTableModel
        >>> factors = [Factor(name, [1, 2, 3]) for name in ("Day", "Robot", "Planner")]
        >>> [run.combination["Planner"] for run in RunTableModel(factors, design=LatinSquare("Day", "Robot")).plan()]
        [1, 2, 3, 2, 3, 1, 3, 1, 2]
    """

    kind: ClassVar[str] = "latin_square"
    rows: str | Factor
    columns: str | Factor

    def findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Say which factors there are not, and whether rows and columns differ in number."""
        del repetitions
        yield from _findings(self, [("rows", self.rows), ("columns", self.columns)], factors)

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the cells of all squares, row by row.

        Raises:
            DesignError: there are not as many treatments as rows, or an exclusion leaves one in some cells only.
        """
        names = [factor_name(self.rows), factor_name(self.columns)]
        roles = Roles.of(factors, names)
        treatments = roles.allowed_treatments("LatinSquare", is_allowed)
        order = len(roles.blocks[0].treatments)
        _refuse_number("LatinSquare", roles, len(treatments), order)
        drawn = seed if shuffle else None
        squares = _filled([latin_square(order)], {"treatments": treatments}, repetitions, drawn)
        facts = {**self.as_mapping(), "row": names[0], "column": names[1]}
        return _in_order(roles, squares, facts)


@dataclass(frozen=True, slots=True)
class GraecoLatinSquare(Described):
    """Two Latin squares one upon the other: each pair of their treatments comes once.

    With `greek`, a third factor is a kind of block, and the other factors are studied, as many combinations as there
    are rows. Without it, exactly two other factors are studied. There is one of each order but 2 and 6.

    Attributes:
        rows: the factor whose treatments are the rows.
        columns: the factor whose treatments are the columns.
        greek: the factor that is spread over the square beside the treatments, such as the operator.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> from robot_runner.core.design.run_table_model import RunTableModel
        >>> factors = [Factor(name, [1, 2, 3]) for name in ("Day", "Robot", "Operator", "Planner")]
        >>> model = RunTableModel(factors, design=GraecoLatinSquare("Day", "Robot", "Operator"))
        >>> [(run.combination["Operator"], run.combination["Planner"]) for run in model.plan()][:3]
        [(1, 1), (2, 2), (3, 3)]
    """

    kind: ClassVar[str] = "graeco_latin_square"
    rows: str | Factor
    columns: str | Factor
    greek: str | Factor | None = None

    def findings(self, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
        """Say which factors there are not, whether they differ in number, and whether there is such a square."""
        del repetitions
        given = [("rows", self.rows), ("columns", self.columns)]
        given += [("greek", self.greek)] if self.greek is not None else []
        findings = list(_findings(self, given, factors))
        yield from findings
        if findings:
            return
        roles = Roles.of(factors, [factor_name(name) for _, name in given])
        order = len(roles.blocks[0].treatments)
        where = "design: GraecoLatinSquare"
        if self.greek is None and len(roles.studied) != 2:  # noqa: PLR2004 - a Latin and a Greek one
            problem = f"{len(roles.studied)} factors are studied beside rows and columns, and a square holds two"
            yield Finding.error(where, problem, "Name one of them as greek=..., or have two.")
        if not has_orthogonal_pair(order):
            problem = f"there is no Graeco-Latin square of order {order}: such squares exist of each order but 2 and 6"
            near = "3" if order < 3 else "5 or 7"  # noqa: PLR2004
            yield Finding.error(where, problem, f"Have {near} treatments of each factor, or take a LatinSquare.")

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the cells of all squares, row by row.

        Raises:
            DesignError: there are not as many treatments as rows, or an exclusion leaves one in some cells only.
        """
        design = "GraecoLatinSquare"
        names = [factor_name(each) for each in (self.rows, self.columns, self.greek) if each is not None]
        roles = Roles.of(factors, names)
        order = len(roles.blocks[0].treatments)
        if self.greek is None:
            latin, greek = (full_factorial([factor]) for factor in roles.studied)
        else:
            latin = roles.allowed_treatments(design, is_allowed)
            greek = full_factorial([roles.blocks[2]])
        for symbols in (latin, greek):
            _refuse_number(design, roles, len(symbols), order)
        drawn = seed if shuffle else None
        squares = _filled(orthogonal_pair(order), {"latin": latin, "greek": greek}, repetitions, drawn)
        facts = {**self.as_mapping(), "row": names[0], "column": names[1]}
        made = _in_order(roles, squares, facts)
        for run in made.runs:
            if not is_allowed(run.combination):
                problem = f"{run.combination} is excluded, and each pair of treatments comes once in the square"
                raise refused(design, problem, "Leave the exclusion out, or take another design.")
        return made


def _findings(design: object, given: Sequence[tuple[str, Any]], factors: Sequence[Factor]) -> Iterator[Finding]:
    """Say which roles cannot be, and whether the factors that have them differ in their number of treatments."""
    name = type(design).__name__
    named = [(role, factor_name(factor)) for role, factor in given]
    findings = list(role_findings(name, named, factors))
    yield from findings
    if findings:
        return
    blocks = Roles.of(factors, [factor for _, factor in named]).blocks
    if len({len(factor.treatments) for factor in blocks}) > 1:
        sizes = ", ".join(f"{factor.name} has {len(factor.treatments)}" for factor in blocks)
        yield Finding.error(f"design: {name}", f"a square has as many rows as columns: {sizes}", "Give equally many.")


def _refuse_number(design: str, roles: Roles, count: int, order: int) -> None:
    if count != order:
        what = " x ".join(factor.name for factor in roles.studied)
        problem = f"{what} has {count} combinations, and the square has {order} rows and columns"
        raise refused(design, problem, f"Have {order} of them, or {count} rows and columns.")


def _filled(
    squares: Sequence[Square], symbols: Mapping[str, Sequence[Combination]], repetitions: int, seed: int | None
) -> list[list[list[tuple[Combination, ...]]]]:
    """Return, for each repetition, the cells of squares one upon the other with what their symbols stand for.

    Rows and columns come in another order in each repetition: the same for all squares, so that they stay orthogonal.
    """
    order = range(len(squares[0]))
    filled = []
    for number in range(1, repetitions + 1):
        rows, columns = shuffled(order, seed, "rows", number), shuffled(order, seed, "columns", number)
        labels = [shuffled(each, seed, purpose, number) for purpose, each in symbols.items()]
        pairs = list(zip(squares, labels, strict=True))
        filled.append(
            [[tuple(its[square[row][column]] for square, its in pairs) for column in columns] for row in rows]
        )
    return filled


def _in_order(
    roles: Roles, squares: Sequence[Sequence[Sequence[tuple[Combination, ...]]]], facts: Mapping[str, Any]
) -> DesignedRuns:
    """Return the cells as runs, a block for each row of each square, and the squares as tables among the facts."""
    rows, columns = roles.blocks[:2]
    runs = [
        (roles.combined((rows, row), (columns, column), *cell), number, (number - 1) * len(square) + place)
        for number, square in enumerate(squares, start=1)
        for place, (row, cells) in enumerate(zip(rows.treatments, square, strict=True), start=1)
        for column, cell in zip(columns.treatments, cells, strict=True)
    ]
    layout = [
        {
            "title": f"Square {number} of {len(squares)}" if len(squares) > 1 else "Square",
            "heading": [f"{rows.name} \\ {columns.name}", *columns.texts],
            "rows": [
                [text, *(" · ".join(map(texts_of_combination, cell)) for cell in cells)]
                for text, cells in zip(rows.texts, square, strict=True)
            ],
        }
        for number, square in enumerate(squares, start=1)
    ]
    blocks = [factor.name for factor in roles.blocks]
    replicate = {"replicate": "Repetition"} if len(squares) > 1 else {}
    return DesignedRuns.in_order(runs, {**facts, **replicate, "block_columns": blocks, "layout": layout})
