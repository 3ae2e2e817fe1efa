"""What the R script and the notebook compute by formulas of their own is what scipy computes."""

from __future__ import annotations

import shutil
import subprocess
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from scipy import optimize, special, stats

TEMPLATES = files("robot_runner.analysis.recomputing") / "templates"
#: F, degrees of freedom and noncentralities; simulated measures may hardly vary: their effects have F in the millions.
CASES = [(5.0, 2.0, 3.3, 0.0), (5.0, 1.0, 30.0, 10.0), (15e3, 1.3, 3.3, 25e3), (1.2e8, 1.24, 3.07, 1e8)]


@pytest.mark.skipif(shutil.which("Rscript") is None, reason="R is not installed (Debian: apt install r-base-core)")
def test_the_noncentral_f_distribution_is_known_however_large_an_effect_is() -> None:
    template = (TEMPLATES / "sizes.R.j2").read_text(encoding="utf-8")
    formula = template[template.index("below_f <-") : template.index("noncentralities_of_f <-")]
    asked = [f'cat(format(below_f({", ".join(map(str, case))}), digits = 15), "\\n")' for case in CASES]
    finished = subprocess.run(
        ["Rscript", "--vanilla", "-"],
        input="\n".join([formula, *asked]),
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert [float(line) for line in finished.stdout.split()] == pytest.approx(
        [stats.ncf.cdf(*case) for case in CASES], rel=1e-8
    )


def test_the_notebook_knows_the_noncentral_f_distribution_as_well_and_as_soon() -> None:
    template = (TEMPLATES / "sizes.py.j2").read_text(encoding="utf-8")
    formula = template[template.index("def below_f(") : template.index("def noncentralities_of_f(")]
    space: dict[str, Any] = {"np": np, "special": special}
    exec(formula, space)  # noqa: S102 - the point
    # Of F in the thousand millions every Poisson weight would fill the memory.
    expected = [stats.ncf.cdf(*case) for case in CASES]
    assert [space["below_f"](*case) for case in CASES] == pytest.approx(expected, rel=1e-7)
    assert 0.4 < space["below_f"](4e10, 1.0, 300.0, 4e10) < 0.6


def test_the_notebook_knows_the_size_of_an_effect_however_small_its_p_value_is() -> None:
    template = (TEMPLATES / "sizes.py.j2").read_text(encoding="utf-8")
    formula = template[template.index("def below_f(") : template.index("{% if study.has(")]
    space: dict[str, Any] = {"np": np, "special": special, "stats": stats, "optimize": optimize}
    exec(formula.replace("{{ 1 - 2 * study.alpha }}", "0.9"), space)  # noqa: S102 - the point
    found = {"statistic": 1.9e9, "df": 3.0, "df 2": 13.3}
    size = space["omega_squared"](found, variance=1.0, spread=1.0, p=1e-30)
    assert size["omega squared low"] < size["omega squared"] == pytest.approx(0.5, abs=1e-4)
    beyond = space["omega_squared"](found, variance=1.0, spread=1.0, p=4.8e-113)
    assert beyond["omega squared"] == pytest.approx(0.5)
    assert np.isnan(beyond["omega squared low"])


@pytest.mark.long
@pytest.mark.skipif(shutil.which("Rscript") is None, reason="R is not installed (Debian: apt install r-base-core)")
def test_an_effect_whose_p_value_is_one_has_no_size_in_r() -> None:
    # Sign flips of blocks have such a p-value where every flip has at least as large a statistic.
    template = (TEMPLATES / "sizes.R.j2").read_text(encoding="utf-8")
    formula = template[template.index("omega_squared <-") :]
    formula = formula[: formula.index("\n}\n") + 3].replace("{{ 1 - 2 * study.alpha }}", "0.9")
    asked = 'cat(omega_squared(c("statistic" = 0.7, "df" = 1, "df 2" = 9, "by p" = 1, "p" = 1), 1, 1))'
    finished = subprocess.run(
        ["Rscript", "--vanilla", "-"],
        input=f"{formula}\n{asked}\n",
        check=True,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert finished.stdout == "1 NA NA NA"


def test_an_effect_whose_p_value_is_a_limit_of_its_interval_has_an_end_of_0() -> None:
    """Of two blocks that differ by 0 and 1, t = 1 is the median of its distribution: no sign changes beyond it."""
    template = (TEMPLATES / "sizes.py.j2").read_text(encoding="utf-8")
    formula = template[template.index("def norm_limits(") : template.index("def omega_squared(")]
    space: dict[str, Any] = {"np": np, "special": special, "stats": stats, "optimize": optimize}
    exec(formula, space)  # noqa: S102 - the point
    low, middle, high = space["norm_limits"](1.0000000000000002, 1, 1, 0.9)
    assert (low, middle) == (0, pytest.approx(0, abs=1e-3))
    assert high > 1
