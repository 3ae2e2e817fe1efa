"""What `make test` needs is installed by two jobs at once: Debian's packages, and the virtual environment."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def _make(folder: Path, **scripts: str) -> tuple[int, list[str]]:
    """Execute `make test` with these scripts; return its exit status and what the scripts noted, in order."""
    shutil.copy(ROOT / "Makefile", folder)
    (folder / "scripts").mkdir()
    for name in ("system_packages", "set_up", "debian_ros", "checks"):
        script = scripts.get(name, f"echo {name} >>noted")
        (folder / "scripts" / f"{name}.sh").write_text(f"{script}\n", encoding="utf-8")
    made = subprocess.run(["make", "test"], cwd=folder, stdin=subprocess.DEVNULL, timeout=120, check=False)
    noted = folder / "noted"
    return made.returncode, noted.read_text(encoding="utf-8").splitlines() if noted.exists() else []


def test_both_are_installed_at_once_and_the_checks_come_after_both(tmp_path: Path) -> None:
    # Each waits for the other: one after the other, they would come to no end.
    meeting = "touch {own}; i=0; until [ -e {other} ] || [ $i -ge 3000 ]; do sleep 0.02; i=$((i + 1)); done\n"
    status, noted = _make(
        tmp_path,
        system_packages=meeting.format(own="a", other="b") + "[ -e b ] && echo installed >>noted",
        set_up=meeting.format(own="b", other="a") + "[ -e a ] && echo installed >>noted",
    )
    assert (status, noted) == (0, ["installed", "installed", "debian_ros", "checks"])


@pytest.mark.parametrize("failed", ["system_packages", "set_up"])
def test_nothing_is_checked_where_one_of_them_failed(tmp_path: Path, failed: str) -> None:
    status, noted = _make(tmp_path, **{failed: "exit 1"})
    assert status != 0
    assert "checks" not in noted
