"""`robot-runner pack` writes a package, and lists what it replaced and left out."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from tests.replication.small_index import pip_settings

from robot_runner.replication import index_hashes
from robot_runner.replication.distributions import canonical


@pytest.fixture
def study(experiment, tmp_path, monkeypatch):
    # What the lock does not have is asked of the package index: here nobody listens.
    for name, text in pip_settings("http://127.0.0.1:9/").items():
        monkeypatch.delenv(name, raising=False) if text is None else monkeypatch.setenv(name, text)
    monkeypatch.setattr(index_hashes, "_MOST_MISSES", 1)  # each takes pip most of a second
    return Path(shutil.copytree(experiment, tmp_path / "small"))


@pytest.mark.usefixtures("study")
class TestPack:
    @pytest.mark.long
    def test_it_says_what_it_wrote_and_what_it_replaced(self, robot_runner, tmp_path, monkeypatch):
        # The lock need not have the versions that are installed here.
        monkeypatch.setattr(
            index_hashes,
            "locked_hashes",
            lambda pins: {canonical(pin.partition("==")[0]): ("ab" * 32,) for pin in pins},
        )
        answer = robot_runner("pack", "small", "--no-hashes")
        assert answer.code == 0, answer.err
        assert answer.out.startswith("small.zip")
        assert "Wheels   robot-runner" in answer.out
        assert "replaced: password, 1 time (config/small.py, line 23)" in answer.out
        assert "replaced: password, 4 times in 4 files (runs/…/log.txt)" in answer.out
        assert re.search(r"Hashes +of all \d\d+ packages needed: pip demands them", answer.out)
        assert "there is no report" in answer.err
        assert (tmp_path / "small.zip").exists()

    @pytest.mark.long
    def test_what_to_do_next_can_be_pasted(self, robot_runner, tmp_path):
        (tmp_path / "small").rename(tmp_path / "my study")
        answer = robot_runner("pack", "my study", "--no-hashes", "--no-wheels")
        assert "robot-runner verify 'my study.zip'" in answer.out
        assert f"robot-runner report '{tmp_path / 'my study'}'" in answer.err
        assert "robot-runner replicate 'my study.zip'" in robot_runner("verify", "my study.zip").out

    @pytest.mark.long
    def test_json_is_all_that_is_printed(self, robot_runner):
        facts = robot_runner("pack", "small", "--to", "a.zip", "--raw", "none", "--no-wheels", "--json").json
        assert {each["name"] for each in facts["left_out"]} == {
            "raw data of BasicTurtlebot3",
            "raw data of Ina219",
            "raw data of PsUtil",
        }
        assert facts["wheels"] == []
        assert len(facts["sha256"]) == 64

    @pytest.mark.long
    def test_hashes_that_cannot_be_had_are_a_warning(self, robot_runner, monkeypatch):
        monkeypatch.setattr(index_hashes, "locked_hashes", lambda _: {})
        advice = "; without --no-hashes the package index is asked for the others"
        assert advice in " ".join(robot_runner("pack", "small", "--no-hashes").out.split())
        answer = robot_runner("pack", "small")
        assert answer.code == 0, answer.err
        assert "pip demands none" in answer.out
        assert "without --no-hashes" not in answer.out
        assert "Asking the package index for the hashes of" in answer.err
        assert "no package index answers, or it has none of them" in answer.err
        assert "127.0.0.1" not in answer.out + answer.err

    @pytest.mark.long
    def test_authors_and_licence_can_be_given(self, robot_runner):
        author = "Ada Lovelace; 0000-0002-1825-0097; Analytical Society; https://ror.org/008xxew50"
        answer = robot_runner("pack", "small", "--author", author, "--licence", "MIT", "--citation", "Ask Ada.")
        assert answer.code == 0
        assert "Ada" not in answer.err

    @pytest.mark.long
    @pytest.mark.parametrize(
        ("words", "problem", "fix"),
        [
            (["--author", "Ada; 0000-0002-1825-0098"], "is not an author", "NAME; ORCID"),
            (["--author", "Ada; a; b; c"], "is not an author", "NAME; ORCID"),
            (["--licence", "do what you want"], "is not a licence", "spdx.org"),
            (["--raw", "Ina"], "no run has raw data of 'Ina'", "'Ina219'"),
            (["--to", "nowhere/a.zip"], "cannot be written", "make the folder"),
        ],
    )
    def test_what_cannot_be_is_refused_with_a_way_out(self, robot_runner, words, problem, fix):
        answer = robot_runner("pack", "small", *words)
        assert answer.code == 2
        assert problem in answer.err or "not an ORCID" in answer.err
        assert fix in answer.err or "0000-0002-1825-0097" in answer.err

    @pytest.mark.long
    @pytest.mark.parametrize("words", [("--raw", "Ina"), ("--to", "nowhere/a.zip"), ("--base-image", "a b")])
    def test_what_cannot_be_is_refused_before_the_index_is_asked(self, robot_runner, monkeypatch, words):
        monkeypatch.setattr(index_hashes, "locked_hashes", lambda _: {})
        monkeypatch.setattr(index_hashes, "ask_index", lambda *_: pytest.fail("the index was asked"))
        answer = robot_runner("pack", "small", *words)
        assert answer.code == 2
        assert "Asking the package index" not in answer.err

    @pytest.mark.long
    def test_a_line_that_may_be_a_secret_is_refused_before_the_index_is_asked(self, robot_runner, study, monkeypatch):
        monkeypatch.setattr(index_hashes, "locked_hashes", lambda _: {})
        monkeypatch.setattr(index_hashes, "ask_index", lambda *_: pytest.fail("the index was asked"))
        (study / "notes.txt").write_text("the token is wanderlust and opens the door\n", encoding="utf-8")
        answer = robot_runner("pack", "small", "--no-wheels")
        assert answer.code == 2
        assert "this line has" in answer.err

    @pytest.mark.long
    def test_the_bar_is_shown_on_a_terminal(self, terminal, study):
        with (study / "runs" / "r_1" / "PsUtil" / "long.csv").open("wb") as file:
            for _ in range(20):
                file.write(b"0.041389,6051,24938,0.605100,12.468\n" * 6000)
        screen = terminal("pack", "small")
        assert screen.finish() == 0
        assert "packing" in screen.raw
        assert "packing" not in screen.text
        assert "small.zip" in screen.text
