"""The firmware is built once a session; without its tools these tests are skipped, and say what to install."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.firmware.simulated_board import BoardClock, build, executed, missing_tools

if TYPE_CHECKING:
    from tests.firmware.simulated_board import Build


@pytest.fixture(scope="session")
def built(tmp_path_factory) -> Build:
    if missing_tools():
        pytest.skip(f"the firmware cannot be built and executed: {missing_tools()}")
    return build(tmp_path_factory.mktemp("firmware"))


@pytest.fixture
def board(built, tmp_path):
    """Return what executes a board whose time goes by while its clock is slept on."""

    def execute(**settings):
        return executed(built, clock=BoardClock(tmp_path / "clock"), **settings)

    return execute


@pytest.fixture
def free_board(built):
    """Return what executes a board whose time goes by itself."""

    def execute(**settings):
        return executed(built, **settings)

    return execute
