"""Latin and Graeco-Latin squares: two or three kinds of blocks at once, with each treatment once in each block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from typing import Any, ClassVar, Final

from robot_runner.core.design.design import DesignedRuns, IsAllowed
from robot_runner.core.design.factor import Combination, Factor, factor_name
from robot_runner.core.design.full_factorial import full_factorial
from robot_runner.core.errors import Finding
from robot_runner.designs.choosing import Described
from robot_runner.designs.factor_roles import Roles, refused, role_findings, shuffled, texts_of_combination
from robot_runner.designs.finite_fields import finite_field


@dataclass(frozen=True, slots=True)
class LatinSquare(Described):
    """Each treatment once in each row and once in each column, such as each day and each robot.

    The other factors are studied: they must have as many combinations as there are rows and columns. Each repetition is
    a separate square. With `shuffle`, rows, columns and treatments are assigned to the square at random. Runs are
    executed row by row, and in each row column by column, in the order of the treatments.

    Attributes:
        rows: the factor whose treatments are the rows.
        columns: the factor whose treatments are the columns.

    Example:
        >>> from robot_runner import Factor, RunTableModel
        >>> factors = [Factor(name, [1, 2, 3]) for name in ("Day", "Robot", "Planner")]
        >>> [run.combination["Planner"] for run in RunTableModel(factors, design=LatinSquare("Day", "Robot")).plan()]
        [1, 2, 3, 2, 3, 1, 3, 1, 2]
    """

    kind: ClassVar[str] = "latin_square"
    rows: str | Factor
    columns: str | Factor

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on unknown factors, and on unequal numbers of rows and columns."""
        yield from _findings(self, [("rows", self.rows), ("columns", self.columns)], factors)

    def runs(
        self, factors: Sequence[Factor], is_allowed: IsAllowed, repetitions: int, seed: int, shuffle: bool
    ) -> DesignedRuns:
        """Return the cells of all squares, row by row.

        Raises:
            DesignError: there are not as many treatments as rows, or one is excluded in some cells only.
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
    """Two orthogonal Latin squares, superimposed: each pair of their treatments occurs once.

    With `greek`, a third factor is a kind of block, and the other factors are studied, with as many combinations as
    there are rows. Without it, exactly two other factors are studied. Squares exist for all orders except 2 and 6.

    Attributes:
        rows: the factor whose treatments are the rows.
        columns: the factor whose treatments are the columns.
        greek: a third blocking factor that is spread over the square, such as the operator.

    Example:
        >>> from robot_runner import Factor, RunTableModel
        >>> factors = [Factor(name, [1, 2, 3]) for name in ("Day", "Robot", "Operator", "Planner")]
        >>> model = RunTableModel(factors, design=GraecoLatinSquare("Day", "Robot", "Operator"))
        >>> [(run.combination["Operator"], run.combination["Planner"]) for run in model.plan()][:3]
        [(1, 1), (2, 2), (3, 3)]
    """

    kind: ClassVar[str] = "graeco_latin_square"
    rows: str | Factor
    columns: str | Factor
    greek: str | Factor | None = None

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the factors, on unequal numbers of treatments, and on orders without a square."""
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
            DesignError: there are not as many treatments as rows, or a combination of the square is excluded.
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
    """Yield findings on the roles, and on unequal numbers of treatments of their factors."""
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
    """Return, for each repetition, the cells of the superimposed squares with the combinations of their symbols.

    Each repetition has another order of rows and columns, the same for all squares, so that they stay orthogonal.
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
    """Return the cells as runs, with a block for each row of each square, and the squares as tables in the facts."""
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


#: The symbol of each cell, by row and column.
Square = tuple[tuple[int, ...], ...]

#: A quasi-difference matrix over the residues of 11 with three points at infinity (None), from which two orthogonal
#: squares of order 14 are developed; no general construction here yields that order. We found it by a search;
#: definition after Colbourn and Dinitz (eds.), Handbook of Combinatorial Designs, 2nd ed., 2007, VI.17.
_OF_14: Final = (
    (0, 0, 7, 5), (0, 10, 5, 1), (0, 8, 0, 8), (0, 7, 1, 3), (0, 5, 6, 0), (0, 2, None, 10), (0, None, 3, 6),
    (0, None, 10, 9), (0, 6, 8, None), (0, None, 4, 4), (0, 1, None, 2), (0, 9, 9, None), (None, 0, 4, 10),
    (0, 4, 2, None), (0, 3, None, 7), (None, 0, 10, 3), (None, 0, 8, 9),
)  # fmt: skip

#: The rows of an orthogonal array: in any two columns, each pair of symbols occurs once.
_Rows = list[tuple[int, ...]]
#: A row of a quasi-difference matrix; None is a point at infinity.
_Differences = tuple[int | None, ...]


def latin_square(order: int) -> Square:
    """Return the cyclic Latin square: each symbol once in each row and column.

    Example:
        >>> latin_square(3)
        ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    """
    return tuple(tuple((row + column) % order for column in range(order)) for row in range(order))


def has_orthogonal_pair(order: int) -> bool:
    """Return whether there are two orthogonal Latin squares of an order: for all orders except 2 and 6.

    Source: Bose, Shrikhande and Parker, Further results on the construction of mutually orthogonal Latin squares and
    the falsity of Euler's conjecture, Canadian Journal of Mathematics 12 (1960), 189-203.
    """
    return order >= 1 and order not in {2, 6}


def orthogonal_pair(order: int) -> tuple[Square, Square]:
    """Return two orthogonal Latin squares: superimposed, they have each pair of symbols once.

    Raises:
        ValueError: there are none of this order.
    """
    if not has_orthogonal_pair(order):
        message = f"there is no pair of orthogonal Latin squares of order {order}"
        raise ValueError(message)
    symbols = {(row, column): rest for row, column, *rest in _array(order, 4)}
    first, second = (
        tuple(tuple(symbols[row, column][which] for column in range(order)) for row in range(order)) for which in (0, 1)
    )
    return first, second


@cache
def _array(order: int, width: int) -> _Rows:
    """Return an orthogonal array of strength two: a row for each pair of symbols, and `width` columns."""
    if order == 1:
        return [(0,) * width]
    if order % 4 != 2:  # noqa: PLR2004 - then all its prime powers are large enough
        return reduce(_product, (_of_field(prime, power, width) for prime, power in _factors(order)))
    if order == 14:  # noqa: PLR2004
        return _developed(_OF_14, 11, 3)
    if order % 6 == 4:  # noqa: PLR2004
        return _developed(list(_parker((order - 1) // 3)), 2 * ((order - 1) // 3) + 1, (order - 1) // 3)
    return _wilson(order)


# Prime powers, and products of orders (MacNeish 1922).


def _of_field(prime: int, power: int, width: int) -> _Rows:
    """Return the array of the lines y = m x + b over a finite field, whose order must be at least `width` - 1."""
    times, plus = finite_field(prime, power)
    elements = range(prime**power)
    return [(x, b, *(plus(times(m, x), b) for m in elements[1 : width - 1])) for x in elements for b in elements]


def _product(one: _Rows, other: _Rows) -> _Rows:
    size = max(symbol for row in other for symbol in row) + 1
    return [tuple(x * size + y for x, y in zip(a, b, strict=True)) for a in one for b in other]


def _factors(number: int) -> Iterable[tuple[int, int]]:
    prime = 2
    while number > 1:
        power = 0
        while number % prime == 0:
            number, power = number // prime, power + 1
        if power:
            yield prime, power
        prime += 1


# Orders of the form 4 n + 2.


def _parker(m: int) -> Iterable[_Differences]:
    """Yield the quasi-difference matrix of order 3 m + 1, for odd m.

    Source: Parker, Orthogonal Latin squares, Proceedings of the National Academy of Sciences 45 (1959), 859-862.
    """
    for i in range(1, m + 1):
        minus = 2 * m + 1 - i
        yield from ((0, i, minus, None), (i, 0, None, minus), (minus, None, 0, i), (None, minus, i, 0))
    yield (0, 0, 0, 0)


def _developed(rows: Sequence[_Differences], modulus: int, infinities: int) -> _Rows:
    """Add each residue to each row of a quasi-difference matrix; infinite points have symbols after the residues."""
    taken = [0, 0, 0, 0]
    array: _Rows = []
    for row in rows:
        infinite = [modulus + count for count in taken]
        taken = [count + (each is None) for count, each in zip(taken, row, strict=True)]
        pairs = list(zip(row, infinite, strict=True))
        array += [
            tuple(symbol if each is None else (each + shift) % modulus for each, symbol in pairs)
            for shift in range(modulus)
        ]
    return array + [tuple(modulus + each for each in row) for row in _array(infinities, 4)]


def _wilson(order: int) -> _Rows:
    """Return the array of an order 3 t + u, from arrays of the orders 3, 4, t and u.

    Source: Wilson, Concerning the number of mutually orthogonal Latin squares, Discrete Mathematics 9 (1974), 181-198.
    """
    sizes = ((t, order - 3 * t) for t in range(order // 3, 0, -1))
    t, u = next((t, u) for t, u in sizes if u <= t and _has_width_of_5(t) and has_orthogonal_pair(u))
    array: _Rows = []
    for *points, last in _array(t, 5):
        if last < u:  # symbol 0 of order 4 is the point `last`; the row with this symbol alone is covered by order u
            array += [
                tuple(
                    3 * t + last if not each else 3 * point + each - 1 for point, each in zip(points, row, strict=True)
                )
                for row in _array(4, 4)
                if any(row)
            ]
        else:
            array += [tuple(3 * point + each for point, each in zip(points, row, strict=True)) for row in _array(3, 4)]
    return array + [tuple(3 * t + each for each in row) for row in _array(u, 4)]


def _has_width_of_5(order: int) -> bool:
    return all(prime**power > 3 for prime, power in _factors(order))  # noqa: PLR2004 - slopes but 0 are columns, too
