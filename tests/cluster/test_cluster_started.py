"""Clusters that are started in other ways: over ssh, and encrypted with certificates of their own."""

from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

import dask.config
import pytest
from tests.cluster.conftest import BIN, PATIENCE, Cluster, Watched, table_of
from tests.core.links.ssh_server import SshServer

from robot_runner.cluster.cluster_checks import check_cluster
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.config.preparation import prepare
from robot_runner.core.plugin import System

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def _executes_all(cluster: Cluster, watched: Watched) -> None:
    watched.go()
    experiment = cluster.experiment(watched.config)
    answer, _ = experiment.communicate(timeout=PATIENCE)
    assert experiment.returncode == 0, answer
    assert [row["Twice"] for row in table_of(watched.folder)] == ["2.0", "4.0", "6.0"]


@pytest.mark.soak
def test_a_worker_that_ssh_starts_executes_runs(cluster: Cluster, watched: Watched, tmp_path: Path) -> None:
    (tmp_path / "sshd").mkdir()
    server = SshServer(tmp_path / "sshd")
    worker = f"{BIN / 'dask'} worker {cluster.address} --nthreads 1 --no-nanny --local-directory {tmp_path / 'there'}"
    ssh = subprocess.Popen(["ssh", "-tt", "-F", str(server.config), "robot", worker], stdin=subprocess.DEVNULL)
    try:
        _executes_all(cluster, watched)
    finally:
        ssh.terminate()
        ssh.wait()
        server.stop()


@pytest.mark.soak
def test_tls_takes_the_certificates_of_dasks_own_configuration(
    start_cluster: Callable[..., Cluster], watched: Watched, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "certificate.pem")
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", key, "-out", certificate]
    subprocess.run([*made, "-days", "2", "-subj", "/CN=127.0.0.1"], check=True, capture_output=True)
    tls = "DASK_DISTRIBUTED__COMM__TLS__"
    settings = {f"{tls}CA_FILE": certificate}
    for role in ("SCHEDULER", "WORKER", "CLIENT"):
        settings |= {f"{tls}{role}__CERT": certificate, f"{tls}{role}__KEY": key}
    cluster = start_cluster(protocol="tls", settings=settings)
    cluster.worker("one")
    _executes_all(cluster, watched)


def test_what_a_cluster_cannot_do_is_found_before_anything_is_executed(watched: Watched) -> None:
    def problems(**settings: str) -> str:
        return " ".join(map(str, prepare(watched.config, settings).findings))

    assert problems(cluster="tcp://scheduler:8786") == ""
    assert "the address of a Dask scheduler, such as tcp://scheduler:8786" in problems(cluster="scheduler")
    watched.config.write_text(
        watched.config.read_text().replace("claims = []", 'robot = Robots("ros2://alice", "ros2://bob")')
    )
    watched.config.write_text("from robot_runner import Robots\n" + watched.config.read_text())
    assert "several robots take turns on this machine" in problems(cluster="tcp://scheduler:8786")
    assert "run_process is IN_PROCESS" in problems(cluster="tcp://scheduler:8786", run_process="in_process")
    assert "DASK_DISTRIBUTED__COMM__TLS__CA_FILE" in problems(cluster="tls://scheduler:8786")


@pytest.mark.parametrize("lasting", ["Program(['true'], per={!r})", "Tune(turbo=False, scope={!r})"])
def test_a_plugin_that_is_set_up_once_for_all_runs_is_refused_as_workers_execute_them(
    watched: Watched, lasting: str
) -> None:
    config = watched.config.read_text().replace(
        "from pathlib", "from robot_runner.plugins.systems import *\nfrom pathlib"
    )

    def problems(span: str, **settings: str) -> list[str]:
        watched.config.write_text(config.replace("claims = []", f"plugins = [{lasting.format(span)}]"))
        found = map(str, prepare(watched.config, settings).findings)
        return [each for each in found if "of a cluster" in each]

    (problem,) = problems("experiment", cluster="tcp://scheduler:8786")
    assert "set up once for all runs, on this machine" in problem
    assert ("scope='run'" in problem) == lasting.startswith("Tune")
    assert ("per='run'" in problem) == lasting.startswith("Program")
    assert problems("experiment") == problems("run", cluster="tcp://scheduler:8786") == []


def test_a_plugin_of_ones_own_and_a_part_of_one_that_are_set_up_once_for_all_runs_are_refused() -> None:
    """Neither has a parameter that says when."""

    class Motors(System):
        is_for_all_runs = True

    class Fleet(System):
        def __init__(self) -> None:
            super().__init__()
            self.members = (Motors(),)

    (finding,) = check_cluster("study.py", Parameters(cluster="tcp://scheduler:8786"), [Fleet()])
    assert finding.where == "plugin Motors"
    assert finding.fix == "Set it up in each run (in start_run), or leave cluster out."


def test_caches_are_dropped_in_each_run_on_its_worker(watched: Watched) -> None:
    config = watched.config.read_text().replace("claims = []", "plugins = [Tune(drop_caches=True)]")
    watched.config.write_text(f"from robot_runner.plugins.systems import Tune\n{config}")
    found = " ".join(map(str, prepare(watched.config, {"cluster": "tcp://scheduler:8786"}).findings))
    assert "of a cluster" not in found


def test_a_setting_of_dasks_configuration_that_cannot_be_is_found(watched: Watched) -> None:
    def problems(**settings: object) -> list[str]:
        with dask.config.set({f"robot_runner.{name}": value for name, value in settings.items()}):
            return list(map(str, prepare(watched.config, {"cluster": "tcp://scheduler:8786"}).findings))

    assert problems(lease="10s", patience=3600, in_place=False) == []
    assert problems(lease="soon", patience="-5m", in_place="no") == [
        "DASK_ROBOT_RUNNER__LEASE: 'soon' is not a length of time → Set it as in DASK_ROBOT_RUNNER__LEASE=30s.",
        "DASK_ROBOT_RUNNER__PATIENCE: '-5m' is not a length of time → Set it as in DASK_ROBOT_RUNNER__PATIENCE=5m.",
        "DASK_ROBOT_RUNNER__IN_PLACE: 'no' is neither True nor False → Set it as in DASK_ROBOT_RUNNER__IN_PLACE=False.",
    ]
    for lease in (0, "", None, "inf", float("inf"), "0s"):
        assert len(problems(lease=lease)) == 1
