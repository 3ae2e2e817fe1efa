"""The first lines of the README, by which a newcomer executes, packs, checks and replicates, do what they say."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from tests.linked_environment import locked_names, make_linked_environment

ROOT = Path(__file__).parents[2]


@pytest.fixture
def clone(tmp_path):
    """A copy of the tree, with an environment in which is what `make demo` installs, and nothing else."""
    folder = tmp_path / "clone"
    for name in ("Makefile", "README.md", "pyproject.toml", "requirements", "scripts", "src"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            # With the bytecode of the modules, which each command would compile anew otherwise, but for that which
            # another process is writing now.
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc.*"))
        else:
            shutil.copyfile(ROOT / name, folder / name)
    make_linked_environment(folder / ".venv", locked_names(folder / "requirements" / "demo.txt"), code=folder / "src")
    stamp = 'printf "%s\\n" "$(pwd -P) $(cat pyproject.toml requirements/*.txt | cksum)" >.venv/.installed-demo'
    subprocess.run(["sh", "-c", stamp], cwd=folder, check=True, timeout=60)
    return folder


#: The demo's own repetitions, with which `make soak` executes it.
FIVE = "range(1, 6)"
#: A hang, s: 40 s of work, which took 190 s where a machine had six times more to do than it could.
_HANG = 900


@pytest.mark.long
@pytest.mark.timeout(_HANG + 60)
@pytest.mark.parametrize("repetitions", [1, pytest.param(5, marks=pytest.mark.soak)])
def test_a_newcomer_in_an_empty_home_ends_in_identical(clone, tmp_path, repetitions):
    demo = clone / "src" / "robot_runner" / "cli" / "templates" / "demo_config.py"
    text = demo.read_text("utf-8")
    assert FIVE in text
    demo.write_text(text.replace(FIVE, f"range(1, {repetitions + 1})"), "utf-8")
    lines = re.findall(
        r"^\$ (make demo|.*robot-runner replicate .*)$", (clone / "README.md").read_text("utf-8"), re.MULTILINE
    )
    assert [line.split()[-1] for line in lines] == ["demo", "--yes"]
    home = tmp_path / "home"
    home.mkdir()
    environment = {"PATH": f"{os.defpath}:/usr/local/bin", "HOME": str(home), "LANG": "C.UTF-8", "PIP_NO_INDEX": "1"}
    answer = subprocess.run(
        ["sh", "-ec", "\n".join(lines)],
        cwd=clone,
        env=environment,
        capture_output=True,
        text=True,
        timeout=_HANG,
        check=False,
    )
    assert answer.returncode == 0, answer.stdout[-2000:] + answer.stderr
    assert answer.stdout.endswith(
        f"The results are identical: every value of {3 * repetitions} runs, to the last digit.\n"
    )
    assert "error" not in answer.stderr
    assert not list(home.iterdir()) or {path.name for path in home.iterdir()} <= {".cache", ".config"}
