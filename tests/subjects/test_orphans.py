"""What a program has started is found by the folder of its start, and ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from robot_runner.subjects.orphans import end_orphans, mark_of

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.skipif(sys.platform != "linux", reason="found by /proc")
@pytest.mark.parametrize("name", [b"1", b"caf\xc3\xa9", b"of no encoding \xff"])
def test_what_is_left_is_killed_whatever_its_folder_is_called(tmp_path: Path, name: bytes) -> None:
    folder = tmp_path / os.fsdecode(name)
    with subprocess.Popen(["/bin/sleep", "60"], env=mark_of(folder)) as left:
        try:
            end_orphans(tmp_path / "another")
            assert left.poll() is None
            end_orphans(folder)
            assert left.wait(5) == -signal.SIGKILL
        finally:
            left.kill()
