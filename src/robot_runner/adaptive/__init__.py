"""Designs whose next runs depend on results: a search for the best treatments, and a race between combinations.

`RunTableModel(factors, design=Optimise("Energy", "minimise", runs=40))` plans the first runs, and decides on the others
once these are done. The library of the search is in the extra `adaptive`.
"""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.adaptive.optimise import Optimise as Optimise
    from robot_runner.adaptive.race import Race as Race
else:
    __getattr__, __dir__ = open_door(__name__)
