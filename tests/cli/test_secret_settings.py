"""What is secret in `--set` or in the environment is neither on the screen nor in the experiment's folder."""

from __future__ import annotations

import json

import pytest

CONFIG = """
db_password = "-"
endpoint = "-"
attempts = 1

def launch_mission(self, context):
    import os, subprocess
    assert self.db_password == "sword" + "fish-9"
    print("python says", os.environ["LAB_TOKEN"])
    subprocess.run(["sh", "-c", "echo a program says $LAB_TOKEN"], check=True)
    if context.run_id == "r_1" and not os.path.exists("mended"):
        raise RuntimeError(f"no login with {os.environ['LAB_TOKEN']}")

def populate_run_data(self, context):
    return {"Energy": 1.0}
"""
SECRETS = ("swordfish-9", "open-sesame-4")


def _nothing_secret(*texts: str) -> bool:
    return not any(secret in text for secret in SECRETS for text in texts)


@pytest.fixture
def study(write_config, monkeypatch):
    monkeypatch.setenv("LAB_TOKEN", SECRETS[1])
    return write_config(CONFIG)


@pytest.mark.long
def test_a_secret_is_neither_shown_nor_kept_and_resuming_knows_it_again(robot_runner, study, tmp_path):
    words = ["config.py", "--plain", "--set", f"db_password={SECRETS[0]}", "--set", f"endpoint={SECRETS[1]}"]
    first = robot_runner(*words)
    assert first.code == 1
    assert "db_password=REDACTED" in first.out + first.err
    assert "--set db_password=..." in first.out + first.err  # how to go on
    log = (tmp_path / "results/trial/runs/r_1/log.txt").read_text(encoding="utf-8")
    assert "python says REDACTED" in log
    assert "a program says REDACTED" in log
    kept = {path: path.read_text(encoding="utf-8") for path in (tmp_path / "results").rglob("*") if path.is_file()}
    assert [str(path) for path, text in kept.items() if not _nothing_secret(text)] == []
    manifest = json.loads((tmp_path / "results/trial/manifest.json").read_bytes())
    assert manifest["deviations"]["db_password"].startswith("REDACTED scrypt:")
    assert "no login with REDACTED" in (tmp_path / "results/trial/journal.jsonl").read_text(encoding="utf-8")

    other = robot_runner("config.py", "--plain", "--set", "db_password=another", "--set", f"endpoint={SECRETS[1]}")
    assert other.code == 2
    assert "set by --set db_password=REDACTED" in other.err
    (tmp_path / "mended").touch()
    again = robot_runner(*words)
    assert again.code == 0, again.err
    for command in (["status", "config.py"], ["explain", "results/trial", "r_1"], ["check", *words[:1], *words[2:]]):
        answer = robot_runner(*command)
        assert _nothing_secret(answer.out, answer.err), command
    assert _nothing_secret(first.out, first.err, other.err, again.out, again.err)


def test_a_value_that_cannot_be_read_is_not_echoed(robot_runner, write_config):
    write_config("wifi_pin = 1")
    answer = robot_runner("check", "config.py", "--set", "wifi_pin=swordfish-9")
    assert answer.code == 2
    assert _nothing_secret(answer.out, answer.err)
