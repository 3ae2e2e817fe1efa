"""The checks of an experiment that a cluster is to execute."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

from robot_runner.core.config.parameters import Parameters, RunProcess
from robot_runner.core.errors import ConfigError, Finding
from robot_runner.core.plugin import Plugin, with_parts

_TLS = "distributed.comm.tls"


def check_cluster(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> list[Finding]:
    """Return what keeps the workers of a cluster from executing the experiment; nothing where no cluster is used."""
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
    for each in {id(part): part for part in with_parts(plugins)}.values():
        if each.is_for_all_runs:
            problem = "it is set up once for all runs, on this machine, and the workers of a cluster execute them"
            spans = [f"{name}='run'" for name in ("per", "scope") if getattr(each, name, None) == "experiment"]
            fix = f"Set it up in each run ({''.join(spans) or 'in start_run'}), or leave cluster out."
            findings.append(Finding.error(f"plugin {each.name}", problem, fix))
    if parameters.cluster.startswith("tls://"):
        findings += _tls_findings(place)
    try:
        cluster_settings()
    except ConfigError as error:
        findings += error.findings
    return findings


def cluster_settings() -> dict[str, Any]:
    """Return our settings in Dask's own configuration: `lease` and `patience` in s, and `in_place`.

    Raises:
        ConfigError: a setting is not a length of time, or neither True nor False.
    """
    import dask.config  # noqa: PLC0415 - of an extra

    settings: dict[str, Any] = {}
    findings = []
    for name, default, example in (("lease", "30s", "30s"), ("patience", "5m", "5m"), ("in-place", True, "False")):
        given = dask.config.get(f"robot-runner.{name}", default)
        is_switch = default is True
        value = (bool(given) if given in (True, False) else None) if is_switch else _seconds(given)
        if value is None:
            variable = f"DASK_ROBOT_RUNNER__{name.replace('-', '_').upper()}"
            what = "neither True nor False" if is_switch else "not a length of time"
            findings.append(Finding.error(variable, f"{given!r} is {what}", f"Set it as in {variable}={example}."))
        settings[name.replace("-", "_")] = value
    ConfigError.refuse(findings)
    return settings


def _seconds(given: Any) -> float | None:
    from dask.utils import parse_timedelta  # noqa: PLC0415 - of an extra

    try:
        seconds = parse_timedelta(given)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):  # whatever Dask's parser raises
        return None
    return seconds if seconds and 0 < seconds < float("inf") else None


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
