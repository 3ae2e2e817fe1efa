"""The line of the README by which a newcomer executes, packs, checks and replicates an experiment does what it says."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SITE = Path(sysconfig.get_path("purelib"))
CODE = """\
import sys

from robot_runner.cli.main import main

sys.exit(main())
"""


@pytest.fixture
def clone(tmp_path):
    """A copy of the tree, with an environment in which is what `make demo` installs, and nothing else."""
    folder = tmp_path / "clone"
    for name in ("Makefile", "README.md", "pyproject.toml", "requirements", "scripts", "src"):
        source = ROOT / name
        copy = shutil.copytree if source.is_dir() else shutil.copyfile
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        copy(source, folder / name, **({"ignore": shutil.ignore_patterns("__pycache__")} if source.is_dir() else {}))
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / ".venv"], check=True, timeout=60)
    site = next((folder / ".venv").glob("lib/python*/site-packages"))
    locked = re.findall(r"^([\w.-]+)==", (folder / "requirements" / "demo.txt").read_text("utf-8"), re.MULTILINE)
    for name in locked:
        _link(name, site)
    _install_editable(folder, site)
    files = "pyproject.toml requirements/demo.txt requirements/test.txt"
    stamp = f'printf "%s\\n" "$(pwd -P) $(cat {files} | cksum)" >.venv/.installed-demo'
    subprocess.run(["sh", "-c", stamp], cwd=folder, check=True, timeout=60)
    return folder


def _link(name, site):
    """Have an installed distribution in another environment, too; one that is for other systems is not here."""
    try:
        found = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return
    for file in found.files or ():
        target = site / file
        if ".." in file.parts or file.suffix == ".pyc" or not Path(str(file.locate())).exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        target.symlink_to(Path(str(file.locate())).resolve())


def _install_editable(folder, site):
    """Install the copied project as `pip install --editable` would."""
    _link("robot-runner", site)
    path_file = next(site.glob("*robot_runner*.pth"))
    path_file.unlink()
    path_file.write_text(f"{folder / 'src'}\n", encoding="utf-8")
    program = folder / ".venv" / "bin" / "robot-runner"
    program.write_text(f"#!{folder}/.venv/bin/python\n{CODE}", encoding="utf-8")
    program.chmod(0o755)


def test_a_newcomer_in_an_empty_home_ends_in_identical(clone, tmp_path):
    lines = re.findall(r"^\$ (make demo .*robot-runner replicate .*)$", (clone / "README.md").read_text("utf-8"), re.M)
    assert len(lines) == 1
    home = tmp_path / "home"
    home.mkdir()
    environment = {"PATH": f"{os.defpath}:/usr/local/bin", "HOME": str(home), "LANG": "C.UTF-8", "PIP_NO_INDEX": "1"}
    answer = subprocess.run(
        ["sh", "-c", lines[0]], cwd=clone, env=environment, capture_output=True, text=True, timeout=280, check=False
    )
    assert answer.returncode == 0, answer.stdout[-2000:] + answer.stderr
    assert answer.stdout.endswith("The results are identical: every value of 15 runs, to the last digit.\n")
    assert "error" not in answer.stderr
    assert not list(home.iterdir()) or {path.name for path in home.iterdir()} <= {".cache", ".config"}
