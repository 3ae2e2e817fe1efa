"""A package that a stranger prepared is refused or read: nothing is written outside, nothing is filled or executed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.hostile.hostile_calls import Tally
from tests.hostile.hostile_folders import Hostile
from tests.hostile.hostile_packages import hostile_packages
from tests.hostile.hostile_visits import visit_package
from tests.hostile.test_hostile_folders import chosen, tell

if TYPE_CHECKING:
    from pathlib import Path

    from tests.hostile.hostile_calls import CallServer
    from tests.hostile.hostile_original import Original

BOUNDED = 60


@pytest.fixture(scope="module")
def every_package(original: Original) -> list[Hostile]:
    """Return all of them: what damages each is worked out from the original, which takes seconds."""
    return list(hostile_packages(original.package))


@pytest.mark.long
def test_the_original_is_intact(original: Original, package_server: CallServer, tmp_path: Path) -> None:
    tally = Tally()
    codes = visit_package(Hostile("original", lambda *_: None), original, package_server, tmp_path / "box", tally)
    assert codes == [0, 0, 2, 0]  # nobody can be asked whether its code may be executed
    assert tally.faults == {}


@pytest.mark.long
def test_hostile_packages(
    every_package: list[Hostile],
    original: Original,
    package_server: CallServer,
    tmp_path: Path,
    record_property: object,
) -> None:
    tally = Tally()
    for number, hostile in enumerate(chosen(every_package, BOUNDED)):
        # Each is verified and replicated in one of the two ways of either.
        visit_package(hostile, original, package_server, tmp_path / "box", tally, every=2, first=number)
    tell(record_property, tally.in_words("hostile packages"))
    assert tally.faults == {}


@pytest.mark.long
@pytest.mark.parametrize("objects_in", ["package.json", pytest.param("", id="each file", marks=pytest.mark.soak)])
def test_bombs_fill_no_memory(
    every_package: list[Hostile], original: Original, package_server: CallServer, tmp_path: Path, objects_in: str
) -> None:
    """25 kB that unpack to 827 MB, and a directory that names a million files."""
    bombs = [each for each in every_package if f"{objects_in} of empty objects" in each.name or "million" in each.name]
    tally = Tally()
    for number, hostile in enumerate(bombs):
        visit_package(hostile, original, package_server, tmp_path / "box", tally, every=2, first=number)
    assert tally.subjects == len(bombs) >= 2
    assert tally.faults == {}


@pytest.mark.soak
@pytest.mark.timeout(14_400)
def test_all_hostile_packages(
    every_package: list[Hostile],
    original: Original,
    package_server: CallServer,
    tmp_path: Path,
    record_property: object,
) -> None:
    tally = Tally()
    for hostile in every_package:
        visit_package(hostile, original, package_server, tmp_path / "box", tally)
    tell(record_property, tally.in_words("hostile packages"))
    assert tally.subjects >= 250
    assert tally.faults == {}
