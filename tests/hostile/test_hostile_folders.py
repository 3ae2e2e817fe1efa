"""A folder that a stranger prepared is a finding at worst: nothing is written outside, nothing hangs or commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.hostile.hostile_calls import Tally, escapes
from tests.hostile.hostile_folders import Hostile, hostile_folders
from tests.hostile.hostile_visits import COMMANDS_OF_FOLDERS, visit_folder
from tests.long_cases import long_but, soak_but

if TYPE_CHECKING:
    from pathlib import Path

    from tests.hostile.hostile_calls import CallServer
    from tests.hostile.hostile_original import Original

BOUNDED = 60
#: In as many parts: the first is executed always, two of them by CI, all in `make soak`.
PARTS, IN_CI = 12, 2

#: As many go through every command before a release.
PROMISED = 250


def chosen(every: list[Hostile], count: int) -> list[Hostile]:
    """Return so many, evenly over all kinds."""
    return [every[place * len(every) // count] for place in range(count)]


@pytest.fixture(scope="module")
def every_folder(original: Original) -> list[Hostile]:
    """Return all of them: what damages each is worked out from the original, which takes seconds."""
    return list(hostile_folders(original.study / original.folder))


@pytest.mark.long
def test_the_original_is_read_by_every_command_that_is_called(
    original: Original, server: CallServer, tmp_path: Path
) -> None:
    """Else all would be refused for another reason than that they are hostile."""
    tally = Tally()
    codes = visit_folder(Hostile("original", lambda *_: None), original, server, tmp_path / "box", tally)
    refused = {words[0] for words, code in zip(COMMANDS_OF_FOLDERS, codes, strict=True) if code}
    # It is no package, nobody is there to be asked, and nobody executes it.
    assert refused == {"verify", "replicate", "continue", "pause"}
    assert tally.faults == {}


@pytest.mark.parametrize("part", [*long_but([0], range(IN_CI)), *soak_but([], range(IN_CI, PARTS))])
def test_hostile_folders(
    part: int,
    every_folder: list[Hostile],
    original: Original,
    server: CallServer,
    tmp_path: Path,
    record_property: object,
) -> None:
    folders = chosen(every_folder, BOUNDED)
    tally = Tally()
    for number, hostile in list(enumerate(folders))[part::PARTS]:
        # With a step that shares no factor with the number of commands, each is called on several kinds.
        every = len(COMMANDS_OF_FOLDERS)
        visit_folder(hostile, original, server, tmp_path / "box", tally, every=every, first=3 * number)
    tell(record_property, tally.in_words("hostile folders"))
    assert tally.faults == {}


@pytest.mark.long
@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.soak)])
def test_escapes_in_every_file_come_to_no_terminal(
    every: int, every_folder: list[Hostile], original: Original, server: CallServer, tmp_path: Path
) -> None:
    """Names, units, treatments, reasons and cells are shown all the same, so that a person sees what is there."""
    hostile = next(each for each in every_folder if "every file" in each.name)
    tally = Tally()
    shown: list[bytes] = []
    visit_folder(hostile, original, server, tmp_path / "box", tally, every=every, said=shown)
    assert tally.faults == {}
    assert b"\\x1b]0;owned" in b"".join(shown)
    assert not any(escapes(each) for each in shown)


@pytest.mark.soak
@pytest.mark.timeout(14_400)
def test_250_hostile_folders_through_every_command(
    every_folder: list[Hostile], original: Original, server: CallServer, tmp_path: Path, record_property: object
) -> None:
    tally = Tally()
    for hostile in chosen(every_folder, PROMISED):
        visit_folder(hostile, original, server, tmp_path / "box", tally)
    tell(record_property, tally.in_words("hostile folders"))
    assert tally.faults == {}


@pytest.mark.soak
@pytest.mark.timeout(14_400)
def test_all_hostile_folders(
    every_folder: list[Hostile], original: Original, server: CallServer, tmp_path: Path, record_property: object
) -> None:
    """Each through some of the commands: all of them through all would take a night."""
    tally = Tally()
    for number, hostile in enumerate(every_folder):
        visit_folder(hostile, original, server, tmp_path / "box", tally, every=10, first=3 * number)
    tell(record_property, tally.in_words("hostile folders"))
    assert tally.subjects > PROMISED
    assert tally.faults == {}


def tell(record_property: object, figures: str) -> None:
    """Have the figures printed at the end of the test run."""
    assert callable(record_property)
    record_property("figure", figures)
