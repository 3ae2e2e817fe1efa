"""Of the kinds of secrets that labs have, hardly one gets into a package, and what is packed still works."""

from __future__ import annotations

import json
import shutil
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from tests.replication.planted_secrets import plant

from robot_runner.replication.opening import open_package
from robot_runner.replication.packing import Packing, pack
from robot_runner.replication.verification import verify_package


@pytest.fixture(scope="module")
def secret_study(experiment, tmp_path_factory):
    folder = Path(shutil.copytree(experiment, tmp_path_factory.mktemp("planted") / "small"))
    return folder, plant(folder)


@pytest.fixture(scope="module")
def packed_secrets(secret_study, tmp_path_factory):
    folder, planted = secret_study
    packed = pack(folder, tmp_path_factory.mktemp("out") / "small.zip", Packing(with_wheels=False, doubtful="replace"))
    return packed, planted


def _contents(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _leaked(planted, contents):
    forms = {
        each.kind: [each.marker.encode(coding) for coding in ("utf-8", "utf-16-le", "utf-16-be")] for each in planted
    }
    return [kind for kind, texts in forms.items() if any(text in raw for text in texts for raw in contents.values())]


def test_hardly_a_secret_is_in_the_package(packed_secrets, record_property):
    packed, planted = packed_secrets
    assert len({each.kind for each in planted}) == len({each.marker for each in planted}) == len(planted) >= 63
    leaked = _leaked(planted, _contents(packed.path))
    record_property(
        "figure", f"secrets: {len(planted) - len(leaked)} of {len(planted)} planted kinds are not in the package"
    )
    assert len(leaked) <= len(planted) // 21, leaked  # 60 of 63


def test_what_is_packed_can_still_be_read(packed_secrets):
    packed, _ = packed_secrets
    contents = _contents(packed.path)
    for name, raw in contents.items():
        if name.endswith(".py"):
            compile(raw, name, "exec")
        elif name.endswith((".json", ".ipynb")):
            json.loads(raw)
        elif name.endswith(".jsonl"):
            assert all(json.loads(line) for line in raw.splitlines())
    yaml.safe_load(contents["config/lab.yaml"])
    tomllib.loads(contents["config/lab.toml"].decode())
    assert "Ende" in contents["runs/r_1/windows.txt"].decode("utf-16")
    with open_package(packed.path) as package:
        assert not [each for each in verify_package(package).findings if each.is_error]
