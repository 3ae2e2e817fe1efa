"""What is not installed is named, with the extra that brings it."""

from __future__ import annotations

import importlib.util

import pytest

from robot_runner.analysis.libraries import MissingLibraryError, require_libraries


def test_nothing_is_said_where_all_are_installed():
    require_libraries()


def test_the_extra_is_named_where_one_is_missing(monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        "robot_runner.analysis.libraries.find_spec", lambda name: None if name == "pyarrow" else found(name)
    )
    with pytest.raises(MissingLibraryError, match="pyarrow is not installed") as missing:
        require_libraries()
    assert missing.value.fix == "Install the extra: pip install 'robot-runner[analysis]'"
    assert isinstance(missing.value, ImportError)
