"""The treatment that a conditional factor has in runs where it does not apply."""

from __future__ import annotations

from typing import Final


class Inactive:
    """The treatment of a factor that does not apply to a run: `Factor("Resolution", [...], when={"Sensor": "camera"})`.

    There is one, `INACTIVE`. In the run table it is written `inactive`: a word, as an empty cell is a missing value,
    and readers take `None` and `NA` for one. A parameter that is bound to the factor keeps its default in such a run.

    Example:
        >>> str(INACTIVE)
        'inactive'
    """

    __slots__ = ()

    def __reduce__(self) -> str:
        return "INACTIVE"  # the one that there is, in other processes, too: combinations are compared by identity

    def __str__(self) -> str:
        return "inactive"

    __repr__ = __str__


INACTIVE: Final = Inactive()
