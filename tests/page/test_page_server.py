"""Who gets what from the page's server: keys, roles, hosts, origins, limits, figures for Prometheus."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import socket
import subprocess
from typing import TYPE_CHECKING

import psutil
import pytest
from tests.command_line import PROGRAM
from tests.conftest import HEAD, written_config
from tests.page.conftest import ServedPage, executed, processor_seconds
from tests.waiting import PATIENCE, wait_until

from robot_runner.core.config.operator_steps import Question
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.journal import read_journal
from robot_runner.page.event_stream import as_json
from robot_runner.page.page_access import Keys, Role

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


FIFTEEN_RUNS = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Computation", "Video", "Network"])], repetitions=5, shuffle=False)
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedPage]:
    """Return a page of an experiment of fifteen runs that all tests of this file ask."""
    from tests.loopback_port import claim_port

    folder = tmp_path_factory.mktemp("shown") / "lab"
    folder.mkdir()
    config = written_config(folder, table=FIFTEEN_RUNS, head=HEAD.replace('"trial"', '"basic_experiment"'))
    overrides = {"results_output_path": str(folder), "run_process": "in_process"}
    execute_experiment(prepare_or_refuse(config, overrides), SilentObserver())
    served = ServedPage(folder, claim_port())
    served.start()
    yield served
    served.stop()


@pytest.fixture(scope="module")
def one(page: ServedPage) -> str:
    """Return the address of the experiment."""
    return f"/api/experiments/{page.experiments['basic_experiment']}"


def test_without_a_key_nothing_of_an_experiment_is_told(page: ServedPage, one: str) -> None:
    paths = [
        "/api/about",
        "/api/events",
        "/metrics",
        f"{one}/events",
        f"{one}/rows",
        f"{one}/curves/r_1",
        f"{one}/report",
    ]
    for key in (None, "Guessed"):
        page.links["Guessed"] = "#key=0123456789abcdef0123456789abcdef"
        assert {path: page.ask(path, key=key).status for path in paths} == dict.fromkeys(paths, 401)
    assert "basic_experiment" not in page.ask("/", key=None).body.decode()
    assert page.act(f"{one}/stop", {}, Authorization="Bearer x").status == 401


def test_who_may_look_cannot_act(page: ServedPage, one: str) -> None:
    bearer = {"Authorization": f"Bearer {page.key('To look')}"}
    assert page.ask(f"{one}/rows", key="To look").status == 200
    refused = page.act(f"{one}/pause", {}, **bearer)
    assert (refused.status, refused.json["problem"]) == (403, "This link is for looking only.")
    assert page.act(f"{one}/pause", {}).status == 409  # who may act is told that nobody executes it


def test_a_key_is_exchanged_for_a_cookie_that_scripts_and_other_sites_do_not_get(page: ServedPage, one: str) -> None:
    answer = page.act("/api/login", {"key": page.key("To look")}, Authorization="")
    cookie = answer.headers["set-cookie"]
    assert answer.json == {"role": "LOOKS"}
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert page.key("To look") not in cookie
    given = cookie.partition(";")[0]
    assert page.ask(f"{one}/rows", key=None, Cookie=given).status == 200
    # Neither more rights nor more time can be written into it.
    forged = given.replace("LOOKS", "ACTS"), re.sub(r"\.(\d+)\.", ".99999999999.", given), given[:-1]
    assert [page.ask(f"{one}/rows", key=None, Cookie=each).status for each in forged] == [401, 401, 401]


def test_other_sites_and_names_are_refused(page: ServedPage, one: str) -> None:
    own = f"127.0.0.1:{page.port}"
    rebound = page.ask("/", Host=f"evil.example:{page.port}")
    assert (rebound.status, "not served under that name" in rebound.json["problem"]) == (421, True)
    assert page.ask("/", Host=f"localhost:{page.port}").status == 200
    assert page.ask("/", Host="[::1]").status == 200
    assert page.ask(f"{one}/rows", Sec_Fetch_Site="cross-site").status == 403
    assert page.ask(f"{one}/rows", Origin="http://evil.example").status == 403
    assert page.act(f"{one}/pause", {}, Origin="http://evil.example").status == 403
    assert page.act(f"{one}/pause", {}, Origin="null").status == 403
    assert (
        page.ask(f"{one}/pause", method="POST", body={}, X_Robot_Runner="1").status == 403
    )  # says not where it is from
    assert page.ask(f"{one}/pause", method="POST", body={}, Origin=f"http://{own}").status == 403  # as a form would
    assert page.act(f"{one}/pause", {"a": "x" * 70_000}).status == 413
    assert page.act(f"{one}/pause", ["no object"]).status == 400


@pytest.mark.long
def test_a_folder_whose_name_is_no_text_is_shown_as_any(serve_page: Callable[..., ServedPage], tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"caf\xe9")
    (folder / os.fsdecode(b"gar\xe7on")).mkdir(parents=True)
    (folder / os.fsdecode(b"gar\xe7on") / "journal.jsonl").touch()
    page = serve_page(folder)
    assert page.ask("/api/about").json["name"] == "caf?"
    metrics = page.ask("/metrics")
    assert (metrics.status, b'folder="caf?/gar?on"' in metrics.body) == (200, True)


def test_proxies_and_tunnels_may_have_a_port_of_their_own(
    serve_page: Callable[..., ServedPage], tmp_path: Path
) -> None:
    page = serve_page(tmp_path, "--name", "lab.example")
    login = {"key": page.key()}
    assert page.act("/api/login", login, Host="lab.example", Origin="https://lab.example").status == 200
    assert page.act("/api/login", login, Host="localhost:9000", Origin="http://localhost:9000").status == 200
    assert page.act("/api/login", login, Host="lab.example", Origin="https://lab.example:9000").status == 403


def test_every_answer_forbids_what_the_page_does_not_need(page: ServedPage, one: str) -> None:
    for path in ("/", "/assets/app.js", f"{one}/rows", "/no/such/page"):
        headers = page.ask(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
    assert [page.ask(f"/assets/{name}").status for name in ("..%2fpage_server.py", "page_server.py", "page.html")] == [
        404
    ] * 3
    assert page.ask("/api/experiments/..%2f..%2fetc/rows").status == 404
    assert page.ask(f"{one}/curves/..%2f..%2f..%2fetc").status == 404
    assert page.ask(f"{one}/curves/..").json in ([], {"problem": "Not Found"})


def test_keys_cannot_be_tried_without_end(serve_page: Callable[..., ServedPage], tmp_path: Path) -> None:
    page = serve_page(tmp_path)
    tried = [page.act("/api/login", {"key": f"{number:032x}"}, Authorization="").status for number in range(13)]
    assert tried[:10] == [403] * 10
    assert tried[-1] == 429


def test_rows_come_in_pages_and_can_be_found(page: ServedPage, one: str) -> None:
    some = page.ask(f"{one}/rows?start=13&count=5").json
    assert (some["total"], [row[1] for row in some["rows"]]) == (15, ["r_14", "r_15"])
    found = page.ask(f"{one}/rows?status=done&text=video").json
    assert (found["total"], {row[3][0] for row in found["rows"]}) == (5, {"Video"})
    assert page.ask(f"{one}/rows?start=-1&count=zzz").json["total"] == 15


def test_a_question_without_an_upper_limit_stops_no_page() -> None:
    question = Question("voltage", float, low=9.5, high=math.inf)
    (told,) = json.loads(as_json({"questions": (question.as_mapping(),)}))["questions"]
    assert (told["low"], told["high"]) == (9.5, "inf")


def test_prometheus_gets_figures(page: ServedPage) -> None:
    told = page.ask("/metrics", key="To look").body.decode()
    labels = 'experiment="basic_experiment",folder="lab/basic_experiment"'
    assert f'robot_runner_runs{{{labels},status="done"}} 15\n' in told
    assert f'robot_runner_state{{{labels},state="done"}} 1\n' in told
    assert all(re.fullmatch(r"#.*|\w+(\{.*\})? -?[\d.e+]+", line) for line in told.splitlines())


@pytest.mark.long
def test_it_sees_what_is_recorded_within_a_second_and_ends_without_a_trace(
    serve_page: Callable[..., ServedPage], write_config: Callable[..., Path], tmp_path: Path
) -> None:
    config = write_config(
        "def launch_mission(self, context):\n    while not Path('go').exists(): context.clock.sleep(0.02)\n"
        "def populate_run_data(self, context): return {'Energy': 1.5}"
    )
    root = tmp_path / "results" / "trial"
    with executed(config) as experiment:
        wait_until(lambda: any(read_journal(root / "journal.jsonl", kinds={"attempt_started"})))
        page = serve_page(tmp_path)
        assert page.process is not None
        one = f"/api/experiments/{page.experiments['trial']}"
        wait_until(lambda: page.ask(f"{one}/rows?status=running").json["total"] == 1)
        assert page.act(f"{one}/pause", {}).json == {"said": "It pauses after r_1."}
        assert (root / ".pause").exists()
        assert page.act(f"{one}/end-pause", {}).json == {"said": "It goes on."}
        refused = page.act(f"{one}/continue", {"run": "r_1", "step": ""})
        assert (refused.status, refused.json["problem"]) == (409, refused.json["problem"])
        assert "does not wait" in refused.json["problem"]
        experiment.send_signal(signal.SIGSTOP)  # what is written now is written by the page
        wait_until(lambda: psutil.Process(experiment.pid).status() == psutil.STATUS_STOPPED)
        before = {path: path.stat().st_mtime_ns for path in root.rglob("*")}
        spent = processor_seconds(page.process.pid)
        with pytest.raises(subprocess.TimeoutExpired):
            page.process.wait(1.0)
        assert processor_seconds(page.process.pid) - spent <= 0.1
        assert {path: path.stat().st_mtime_ns for path in root.rglob("*")} == before, "the page wrote something"
        experiment.send_signal(signal.SIGCONT)
        page.process.kill()  # nobody notices
        page.process.communicate()
        (tmp_path / "go").touch()
        assert experiment.wait(timeout=60) == 0


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["no-such"], "there is no such folder"),
        (["--port", "99999"], "'99999' is not a port"),
        (["--host", "robot"], "'robot' is not an address"),
        (["--host", "192.0.2.7"], "this machine has no such address"),
    ],
)
def test_what_is_wrong_is_said(words: list[str], problem: str, tmp_path: Path) -> None:
    answer = subprocess.run(
        [PROGRAM, "watch", *words], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert (answer.returncode, problem in answer.stderr, "fix:" in answer.stderr) == (2, True, True)


@pytest.mark.long
def test_a_port_in_use_and_a_missing_extra_are_said(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        answer = subprocess.run(
            [PROGRAM, "watch", "--port", port], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
        )
    assert (answer.returncode, f"port {port} is in use" in answer.stderr) == (2, True)
    (tmp_path / "uvicorn.py").write_text("raise ImportError('gone', name='uvicorn')")
    lacking = {**os.environ, "PYTHONPATH": str(tmp_path)}
    answer = subprocess.run(
        [PROGRAM, "watch"], cwd=tmp_path, env=lacking, capture_output=True, text=True, timeout=60, check=False
    )
    assert (answer.returncode, "robot-runner[page]" in answer.stderr) == (2, True)


@pytest.mark.long
def test_a_page_beside_an_execution_ends_with_it(write_config: Callable[..., Path], tmp_path: Path) -> None:
    from tests.loopback_port import claim_port

    config = write_config("def populate_run_data(self, context): return {'Energy': 1.5}")
    port = claim_port()
    command = [PROGRAM, "run", str(config), "--page-at", f"127.0.0.1:{port}"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout.startswith("Live page of results/trial\n")) == (0, True)
    assert f"http://127.0.0.1:{port}/#key=" in done.stdout
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0, "it still listens"
        probe.close()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        refused = subprocess.run(
            [*command, "--redo", "r_1"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
        )
    assert (refused.returncode, f"port {port} is in use" in refused.stderr) == (2, True)
    kinds = [each["kind"] for each in read_journal(tmp_path / "results" / "trial" / "journal.jsonl")]
    assert kinds.count("experiment_started") == 1, "it was executed without its page"


def test_the_secret_of_the_links_can_be_read_by_its_user_alone_from_the_first_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    (tmp_path / "robot-runner").mkdir(mode=0o755)
    seen: list[int] = []
    rename = os.replace

    def rename_and_look(source: str, target: str, **folders: int) -> None:
        rename(source, target, **folders)
        seen.append(os.stat(target, dir_fd=folders["dst_dir_fd"]).st_mode & 0o077)

    monkeypatch.setattr(os, "replace", rename_and_look)
    first = Keys.of_user()
    assert seen == [0]
    assert Keys.of_user().key(Role.LOOKS) == first.key(Role.LOOKS)


@pytest.mark.long
def test_whoever_sends_what_is_no_request_prints_nothing_into_the_terminal(
    serve_page: Callable[..., ServedPage], tmp_path: Path
) -> None:
    page = serve_page(tmp_path)
    for sent in (
        b"\x16\x03\x01 TLS\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nConnection: upgrade\r\nUpgrade: x\r\n\r\n",
    ):
        with socket.create_connection(("127.0.0.1", page.port), timeout=PATIENCE) as connection:
            connection.sendall(sent)
            assert connection.recv(100)
    process, page.process = page.process, None
    assert process is not None
    process.terminate()
    assert process.communicate(timeout=PATIENCE)[0].strip() == ""


@pytest.mark.long
def test_new_links_make_the_old_ones_void(serve_page: Callable[..., ServedPage], tmp_path: Path) -> None:
    state = tmp_path / "state"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(state))
        first = serve_page(tmp_path)
        second = serve_page(tmp_path, "--new-links")
        third = serve_page(tmp_path, "--read-only")
    assert oct((state / "robot-runner" / "page-secret").stat().st_mode & 0o777) == "0o600"
    assert len({first.key(), second.key()}) == 2
    assert second.ask("/api/about", Authorization=f"Bearer {first.key()}").status == 401
    assert json.loads(second.ask("/api/about").body)["may_act"] is True
    assert third.ask("/api/about", Authorization=f"Bearer {second.key()}").json["may_act"] is False
