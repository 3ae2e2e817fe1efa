"""What the tests need of the system is named before it is installed, and can be gone without."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ("sh", "dirname", "grep", "mktemp", "rm")


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A folder with the script, on a Debian of which tshark alone is not installed; its apt-get notes its calls."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "bin").mkdir()
    shutil.copy(ROOT / "scripts" / "system_packages.sh", tmp_path / "scripts")
    _write(tmp_path / "scripts" / "debian_ros.sh", "echo ros >>calls")
    for tool in TOOLS:
        (tmp_path / "bin" / tool).symlink_to(shutil.which(tool) or f"/bin/{tool}")
    _write(tmp_path / "bin" / "dpkg-query", 'case "$*" in *tshark) exit 1 ;; esac\necho install ok installed')
    _write(tmp_path / "bin" / "apt-get", 'echo "apt-get $*" >>calls')
    _write(tmp_path / "bin" / "id", "echo 0")
    return tmp_path


def _write(program: Path, script: str) -> None:
    program.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    program.chmod(0o755)


def _execute(clone: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", "scripts/system_packages.sh"],
        cwd=clone,
        env={"PATH": str(clone / "bin"), **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def _calls(clone: Path) -> list[str]:
    return (clone / "calls").read_text(encoding="utf-8").splitlines()


def test_what_is_missing_is_named_before_it_is_installed(clone):
    _write(clone / "bin" / "apt-get", 'echo "apt-get $*" >>calls\nkill -KILL $PPID')
    answer = _execute(clone)
    assert "about to install these Debian packages on this machine, which the tests need: tshark\n" in answer.stdout
    assert "To go without them, set ROBOT_RUNNER_SYSTEM_PACKAGES=no" in answer.stdout
    assert _calls(clone)[0] == "apt-get -q update"


def test_it_is_installed(clone):
    assert _execute(clone).returncode == 0
    assert _calls(clone) == ["apt-get -q update", "apt-get install -q -y --no-install-recommends tshark", "ros"]


def test_a_package_that_cannot_be_had_is_named(clone):
    _write(clone / "bin" / "apt-get", "exit 100")
    answer = _execute(clone)
    assert answer.returncode == 0
    assert "tshark could not be installed: the tests that need it are skipped" in answer.stdout


@pytest.mark.parametrize(
    ("user", "environment", "said"),
    [
        (
            "0",
            {"ROBOT_RUNNER_SYSTEM_PACKAGES": "no"},
            "not installed, as ROBOT_RUNNER_SYSTEM_PACKAGES=no asks: tshark\n",
        ),
        ("1000", {}, "To install them: sudo apt install tshark\n"),
    ],
)
def test_without_them_nothing_is_installed_and_the_missing_ones_are_named(clone, user, environment, said):
    _write(clone / "bin" / "id", f"echo {user}")
    answer = _execute(clone, **environment)
    assert answer.returncode == 0
    assert said in answer.stdout
    assert "The tests that need them are skipped" in answer.stdout
    assert _calls(clone) == ["ros"], "Debian's ROS is still found where it is installed"


def test_nothing_is_said_where_nothing_is_missing(clone):
    _write(clone / "bin" / "dpkg-query", "echo install ok installed")
    answer = _execute(clone)
    assert (answer.returncode, answer.stdout) == (0, "")


def test_on_another_system_the_packages_are_named(clone):
    (clone / "bin" / "dpkg-query").unlink()
    answer = _execute(clone)
    assert answer.returncode == 0
    assert "this is not Debian" in answer.stdout
    assert "tshark" in answer.stdout


def test_any_other_word_is_refused(clone):
    answer = _execute(clone, ROBOT_RUNNER_SYSTEM_PACKAGES="never")
    assert answer.returncode == 1
    assert "Set it to no, or leave it out." in answer.stderr
