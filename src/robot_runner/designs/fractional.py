"""Fractional factorials: a fraction of the combinations of two-level factors, and its aliases."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from typing import Any

from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.design_findings import MAX_RUNS
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import DesignError, Finding, did_you_mean
from robot_runner.designs.choosing import at_places, left_out_warning, number_findings

_RESOLUTIONS = (3, 4, 5)
#: The most effects (main effects and two-factor interactions) whose aliases are listed; larger studies are screenings.
_MOST_LISTED = 2000
#: The largest fractions, as powers of two, in which the fewest short words are searched, and the letters that count.
_MOST_IMPROVED, _MOST_LETTERS = 7, 6
#: The largest fractions that are searched, as powers of two, by resolution: at 5 the search takes a second.
_MOST_BITS = {3: MAX_RUNS.bit_length() - 1, 4: MAX_RUNS.bit_length() - 1, 5: 12}


@dataclass(frozen=True, slots=True, kw_only=True)
class FractionalFactorial:
    """A regular fraction of a two-level factorial, 2^(k-p): half of the combinations, a quarter, an eighth, ...

    Its `resolution` says which effects are not aliased: at 3 main effects with each other, at 4 main effects with
    two-factor interactions, at 5 these with each other either (Box, Hunter & Hunter, Statistics for Experimenters, 2nd
    ed., ch. 6). A factor with a range has its two ends as treatments.

    Attributes:
        resolution: the least resolution: 3, 4 or 5. The smallest fraction that is found is taken.
        runs: the number of combinations, a power of two, instead of `resolution`; the best resolution that is found is
            taken.
        generators: the factors that are products of others, by name, instead of both:
            `{"Load": ["Speed", "Task", "Map"]}`.

    Example:
        >>> from robot_runner import Factor
        >>> factors = [Factor(name, [0, 1]) for name in "ABCDEFG"]
        >>> len(FractionalFactorial(resolution=3).choose(factors, lambda combination: True).combinations)
        8
    """

    resolution: int | None = None
    runs: int | None = None
    generators: Mapping[str, Sequence[str]] | None = None

    def as_mapping(self) -> Mapping[str, Any]:
        """Return its kind and the given parameters."""
        generators = self.generators and {name: list(factors) for name, factors in self.generators.items()}
        given = {"resolution": self._resolution, "runs": self.runs, "generators": generators}
        return {"kind": "fractional_factorial", **{name: each for name, each in given.items() if each is not None}}

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the factors and the parameters."""
        for factor in factors:
            if len(factor.treatments) != 2:  # noqa: PLR2004 - a two-level design
                fix = "Give it two, or choose CoveringArray or DOptimal, which take any number."
                problem = f"the factor has {len(factor.treatments)} treatments, and a fraction takes two"
                yield Finding.error(f"factor {factor.name!r}", problem, fix)
        given = [name for name in ("resolution", "runs", "generators") if getattr(self, name) is not None]
        if len(given) > 1:
            yield Finding.error("design", f"{' and '.join(given)} are given: one follows from the other", "Give one.")
        elif self.generators is not None:
            yield from self._generator_findings([factor.name for factor in factors])
        elif self.runs is not None:
            yield from self._run_findings(len(factors))
        elif self._resolution not in _RESOLUTIONS:
            yield Finding.error("design", f"resolution={self.resolution!r} is none of 3, 4 and 5", "Give 3, 4 or 5.")
        elif fraction_words(len(factors), self._resolution) is None:
            most = f"{1 << _MOST_BITS[self._resolution]:,} runs for {len(factors):,} factors"
            problem = f"resolution {self._resolution} takes more than {most}"
            yield Finding.error("design", problem, "Give a lower resolution, or fewer factors.")

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the fraction; of the basic factors, the first one changes slowest."""
        names = [factor.name for factor in factors]
        words = self._words(names)
        every = at_places(factors, fraction_rows(words))
        kept = [each for each in every if is_allowed(each)]
        facts: dict[str, Any] = {
            "kind": "fractional_factorial",
            "resolution": _resolution_of(words),
            "fraction": f"2^({len(names)}-{len(names) - _bits(words)})",
            "aliases": _aliases(names, words),
            "model": "main" if _resolution_of(words) < 5 else "interactions",  # noqa: PLR2004 - see the class
        }
        if len(names) * (len(names) + 1) // 2 > _MOST_LISTED:
            facts["aliases_listed"] = False
        warnings = left_out_warning(len(every), len(kept), "its effects are no longer orthogonal")
        if warnings:
            facts["left_out"] = len(every) - len(kept)
        return ChosenCombinations(kept, facts, warnings=warnings)

    @property
    def _resolution(self) -> int | None:
        is_open = self.resolution is None and self.runs is None and self.generators is None
        return 4 if is_open else self.resolution

    def _words(self, names: Sequence[str]) -> list[int]:
        if self.generators is not None:
            return _generated(names, self.generators)
        if self.runs is not None:
            words = _best_words(len(names), self.runs.bit_length() - 1)
        else:
            words = fraction_words(len(names), self._resolution or 0)
        if words is None:  # reported by `findings`
            raise DesignError("there is no such fraction", where="design", fix="Ask for more runs.")
        return words

    def _run_findings(self, factors: int) -> Iterator[Finding]:
        runs: Any = self.runs
        wrong = list(number_findings("runs", runs, 2, MAX_RUNS))
        yield from wrong
        if wrong:
            return
        least = 1 << factors.bit_length()
        below, above = 1 << (runs.bit_length() - 1), 1 << runs.bit_length()
        if runs & (runs - 1):
            possible = sorted({min(max(below, least), 1 << factors), min(max(above, 2 * least), 1 << factors)})
            fix = f"Give {' or '.join(map(str, possible))}."
            yield Finding.error("design", f"runs={runs} is not a power of two", fix)
        elif runs < least:
            problem = f"runs={runs} cannot tell the main effects of {factors} factors apart"
            yield Finding.error("design", problem, f"Give {least} or more.")
        elif runs > 1 << factors:
            problem = f"runs={runs}, and the full factorial has {1 << factors}"
            yield Finding.error("design", problem, "Give fewer; repetitions=2 executes each combination twice.")

    def _generator_findings(self, names: Sequence[str]) -> Iterator[Finding]:
        generators: Any = self.generators
        if not isinstance(generators, Mapping) or not all(
            isinstance(each, Sequence) and not isinstance(each, str) and each for each in generators.values()
        ):
            fix = 'Give factors and the factors that they are the product of: {"Load": ["Speed", "Task"]}.'
            yield Finding.error("design", f"generators={generators!r} are none", fix)
            return
        basic = [name for name in names if name not in generators]
        found = False
        for name, others in generators.items():
            where = f"generators[{name!r}]"
            if name not in names:
                found = True
                yield Finding.error(where, f"there is no factor {name!r}", did_you_mean(str(name), names))
            for other in others:
                if other not in basic:
                    found = True
                    is_own = other in [*generators]  # a given value may have no hash
                    problem = f"{other!r} is generated itself" if is_own else f"there is no factor {other!r}"
                    yield Finding.error(where, problem, did_you_mean(str(other), basic))
        if found:
            return
        by_word = defaultdict(list)
        for name, word in zip(names, _generated(names, generators), strict=True):
            by_word[word].append(name)
        for word, same in by_word.items():
            if len(same) > 1 or not word:
                problem = f"the main effects of {' and '.join(same)} could not be told apart"
                yield Finding.error("generators", problem, "Give them other products.")


# A column of a fraction is a word: its bits are the basic factors of its product. A basic factor has one bit.


def fraction_words(factors: int, resolution: int) -> list[int] | None:
    """Return the words of the smallest fraction with at least a resolution, one per factor; None if none is found.

    For resolutions 3 and 4 it is the smallest possible; for 5 it is a greedy choice, as good as the tables of Box,
    Hunter & Hunter (2005, table 6.22) up to 11 factors. Up to 64 runs and 13 factors it has minimum aberration (Chen,
    Sun & Wu 1993, International Statistical Review 61, 131-145).
    """
    most = _MOST_BITS[resolution]
    found = next((bits for bits in range(1, most + 1) if _words_of(factors, bits, resolution)), None)
    return None if found is None else _best_words(factors, found)


def _best_words(factors: int, bits: int) -> list[int] | None:
    known = [words for each in reversed(_RESOLUTIONS) if (words := _words_of(factors, bits, each))]
    if not known or bits > _MOST_IMPROVED or factors <= bits:
        return next(iter(known), None)
    basic = [1 << place for place in reversed(range(bits))]
    begun = [*known, *([*basic, (1 << size) - 1] for size in range(2, bits + 1))]
    return min((_least_aliased(words, factors, bits) for words in begun), key=lambda each: each[0])[1]


def _least_aliased(words: Sequence[int], factors: int, bits: int) -> tuple[list[int], list[int]]:
    """Add words one by one, each the one that makes the fewest short words in the defining relation.

    The aim is minimum aberration (Fries & Hunter 1980, Technometrics 22(4)): few words of three letters, which alias
    main effects with interactions of two factors, then few of four, which alias these with each other.

    Returns:
        The numbers of words of three letters, of four, and so on, in the defining relation; and the words of factors.
    """
    words = list(words)
    # How many products of 0, 1, 2, ... of the words each word is.
    products = [[1] + [0] * ((1 << bits) - 1), *([0] * (1 << bits) for _ in range(_MOST_LETTERS))]
    for added in range(factors):
        if added == len(words):
            left = sorted({*range(1, 1 << bits)} - {*words})
            words.append(min(left, key=lambda each: [products[size][each] for size in range(2, _MOST_LETTERS)]))
        word = words[added]
        for size in range(_MOST_LETTERS, 0, -1):
            shorter = products[size - 1]
            products[size] = [count + shorter[place ^ word] for place, count in enumerate(products[size])]
    return [products[size][0] for size in range(3, _MOST_LETTERS + 1)], words


def _words_of(factors: int, bits: int, resolution: int) -> list[int] | None:
    basic = [1 << place for place in reversed(range(bits))]
    if factors <= bits:
        return basic[:factors] if factors == bits else None
    if resolution == 5:  # noqa: PLR2004
        return _apart(basic, factors) if bits <= _MOST_BITS[5] else None
    # Resolution 3 needs distinct words; resolution 4 odd ones, as no product of two of them is odd.
    sizes = range(2, bits + 1) if resolution == 3 else range(3, bits + 1, 2)  # noqa: PLR2004
    words = [*basic, *islice(_products(bits, sizes), factors - bits)]
    return words if len(words) == factors else None


def _products(bits: int, sizes: Iterable[int]) -> Iterator[int]:
    """Yield the products of these numbers of basic factors, in ascending order within each size."""
    for size in sizes:
        word = (1 << size) - 1
        while word < 1 << bits:
            yield word
            low = word & -word
            above = word + low
            word = above | ((word ^ above) // low >> 2)  # the next word with as many bits (Gosper, HAKMEM, item 175)


def _apart(basic: list[int], factors: int) -> list[int] | None:
    """Return words whose main effects and two-factor interactions are not aliased; the longest are tried first."""
    if factors * (factors + 1) // 2 >= 1 << len(basic):
        return None  # each main effect and two-factor interaction needs its own word
    bits = len(basic)
    for order in (_products(bits, range(bits, 1, -1)), sorted(_products(bits, range(2, bits + 1)))):
        words, pairs = list(basic), {0, *basic, *(one ^ other for one, other in combinations(basic, 2))}
        for word in order:
            new = {word, *(word ^ other for other in words)}
            if len(words) < factors and not new & pairs:
                words.append(word)
                pairs |= new
        if len(words) == factors:
            return words
    return None


def _generated(names: Sequence[str], generators: Mapping[str, Sequence[str]]) -> list[int]:
    basic = [name for name in names if name not in generators]
    bit_of = {name: 1 << place for place, name in zip(reversed(range(len(basic))), basic, strict=True)}
    for name, others in generators.items():
        word = 0
        for other in others:
            word ^= bit_of[other]
        bit_of[name] = word
    return [bit_of[name] for name in names]


def fraction_rows(words: Sequence[int]) -> Iterator[list[int]]:
    """Yield the rows of a fraction: 0 for the first treatment of a factor, 1 for the second.

    With -1 and +1 instead, a factor is the product of the basic factors in its word.
    """
    lengths = [word.bit_count() for word in words]
    for row in range(1 << _bits(words)):
        yield [1 - (length - (row & word).bit_count()) % 2 for word, length in zip(words, lengths, strict=True)]


def _bits(words: Sequence[int]) -> int:
    return max(words).bit_length()


def _resolution_of(words: Sequence[int]) -> int:
    """Return the resolution, where 5 includes higher ones; that of a full factorial is the number of factors + 1."""
    if _bits(words) == len(words):
        return max(len(words) + 1, 5)
    known = set(words)
    pairs = [one ^ other for one, other in combinations(words, 2)]
    if not known.isdisjoint(pairs):
        return 3
    return 4 if len(set(pairs)) < len(pairs) else 5


def _aliases(names: Sequence[str], words: Sequence[int]) -> list[list[list[str]]]:
    """Return groups of aliased main effects and two-factor interactions, each effect as its factors.

    The result is empty if there are too many effects for readers.
    """
    if len(names) * (len(names) + 1) // 2 > _MOST_LISTED:
        return []
    groups: defaultdict[int, list[list[str]]] = defaultdict(list)
    named = list(zip(names, words, strict=True))
    for name, word in named:
        groups[word].append([name])
    for (one, its), (other, others) in combinations(named, 2):
        groups[its ^ others].append([one, other])
    return [group for group in groups.values() if len(group) > 1]
