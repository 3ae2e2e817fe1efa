"""What the R script computes by formulas of its own is what scipy computes."""

from __future__ import annotations

import shutil
import subprocess
from importlib.resources import files

import pytest
from scipy import stats

TEMPLATE = files("robot_runner.analysis.recomputing") / "templates" / "sizes.R.j2"


@pytest.mark.skipif(shutil.which("Rscript") is None, reason="R is not installed (Debian: apt install r-base-core)")
def test_the_noncentral_f_distribution_is_known_however_large_an_effect_is() -> None:
    # Simulated measures may hardly vary: their effects have F in the millions.
    cases = [(5.0, 2.0, 3.3, 0.0), (5.0, 1.0, 30.0, 10.0), (15e3, 1.3, 3.3, 25e3), (1.2e8, 1.24, 3.07, 1e8)]
    template = TEMPLATE.read_text(encoding="utf-8")
    formula = template[template.index("below_f <-") : template.index("noncentralities_of_f <-")]
    asked = [f'cat(format(below_f({", ".join(map(str, case))}), digits = 15), "\\n")' for case in cases]
    finished = subprocess.run(
        ["Rscript", "--vanilla", "-"],
        input="\n".join([formula, *asked]),
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert [float(line) for line in finished.stdout.split()] == pytest.approx(
        [stats.ncf.cdf(*case) for case in cases], rel=1e-8
    )
