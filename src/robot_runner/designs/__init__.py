"""Designs: they choose the combinations of an experiment, or its runs with their blocks and order.

Give one to the run table: `RunTableModel(factors, design=CoveringArray(strength=2))`. The libraries of designs are in
the extra `designs`, and are imported when a design is used.
"""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.core.design.design import ChosenCombinations as ChosenCombinations
    from robot_runner.core.design.design import CombinationDesign as CombinationDesign
    from robot_runner.core.design.design import Design as Design
    from robot_runner.core.design.design import DesignedRuns as DesignedRuns
    from robot_runner.core.design.design import FullFactorial as FullFactorial
    from robot_runner.designs.blocked import Blocks as Blocks
    from robot_runner.designs.covering import CoveringArray as CoveringArray
    from robot_runner.designs.crossover import Crossover as Crossover
    from robot_runner.designs.fractional import FractionalFactorial as FractionalFactorial
    from robot_runner.designs.one_at_a_time import OneFactorAtATime as OneFactorAtATime
    from robot_runner.designs.optimal import DOptimal as DOptimal
    from robot_runner.designs.response_surface import BoxBehnken as BoxBehnken
    from robot_runner.designs.response_surface import CentralComposite as CentralComposite
    from robot_runner.designs.space_filling import LatinHypercube as LatinHypercube
    from robot_runner.designs.space_filling import Sobol as Sobol
    from robot_runner.designs.split_plot import SplitPlot as SplitPlot
    from robot_runner.designs.squares import GraecoLatinSquare as GraecoLatinSquare
    from robot_runner.designs.squares import LatinSquare as LatinSquare
else:
    __getattr__, __dir__ = open_door(__name__)
