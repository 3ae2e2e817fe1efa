"""The original that everything hostile is made from, and what calls the program on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.hostile.hostile_calls import CallServer
from tests.hostile.hostile_original import Original, original_of_session

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(scope="session")
def original(tmp_path_factory: pytest.TempPathFactory) -> Original:
    """Return a small experiment that was executed, and its package; nobody may change them."""
    return original_of_session(tmp_path_factory)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CallServer]:
    """Call the program, each time in a process of its own."""
    with CallServer(tmp_path_factory.mktemp("calls")) as served:
        yield served


@pytest.fixture(scope="module")
def package_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CallServer]:
    """Call the program on packages, each time in a process of its own."""
    with CallServer(tmp_path_factory.mktemp("calls"), packages_only=True) as served:
        yield served
