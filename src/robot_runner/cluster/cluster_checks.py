"""What validation says of an experiment that a cluster is to execute."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from robot_runner.core.config.parameters import RunProcess
from robot_runner.core.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.plugin import Plugin

_TLS = "distributed.comm.tls"


def check_cluster(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> list[Finding]:
    """Return what keeps the workers of a cluster from executing the experiment; nothing where none is to."""
    del plugins
    if parameters.cluster is None:
        return []
    place = f"{where}.cluster"
    if find_spec("distributed") is None:
        fix = "Install it, here and where the workers are: pip install 'robot-runner[cluster]'."
        return [Finding.error(place, "Dask's `distributed` is not installed", fix)]
    findings = []
    if parameters.run_process is RunProcess.IN_PROCESS:
        problem = "run_process is IN_PROCESS, and a worker executes runs in processes of their own"
        findings.append(Finding.error(f"{where}.run_process", problem, "Leave run_process out, or choose SPAWN."))
    if parameters.robots:
        problem = "several robots are named, and the workers of a cluster are the places of runs"
        fix = "Name one robot, or leave cluster out; a claim such as robot:alice leads runs to the worker beside it."
        findings.append(Finding.error(f"{where}.robot", problem, fix))
    if parameters.cluster.startswith("tls://"):
        findings += _tls_findings(place)
    return findings


def _tls_findings(place: str) -> list[Finding]:
    """Return what Dask's own configuration lacks for an encrypted connection."""
    import dask.config  # noqa: PLC0415 - of an extra
    import distributed.config  # noqa: F401, PLC0415 - brings the defaults

    lacking = [name for name in (f"{_TLS}.ca-file", f"{_TLS}.client.cert") if not dask.config.get(name, None)]
    if not lacking:
        return []
    names = " and ".join(f"DASK_{name.replace('.', '__').replace('-', '_').upper()}" for name in lacking)
    problem = f"TLS needs certificates, and Dask's configuration has no {' and no '.join(lacking)}"
    return [Finding.error(place, problem, f"Set {names}, or name the files in ~/.config/dask/distributed.yaml.")]
