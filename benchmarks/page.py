"""What the live page costs, and how soon it shows what is recorded: one viewer, fifty, ten thousand runs."""

from __future__ import annotations

import http.client
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import median
from typing import Any

import psutil  # type: ignore[import-untyped]

from benchmarks.table import Row, print_table

_PROGRAM = str(Path(sys.executable).with_name("robot-runner"))
_RUNS, _VIEWERS = 10_000, 50
#: How long the page is watched while nothing happens, and how often something happens then, s.
_IDLE, _EVERY = 10.0, 0.2
_RECORDS = 50
#: Attempts that are recorded to see whether memory grows: each run is executed again.
_MORE = 20_000
_AT = "2026-01-31T12:00:00.000Z"


def main() -> None:
    """Serve the page of an experiment of 10,000 runs, whose journal this process writes."""
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch) / "large"
        _make_experiment(root)
        page = _Page(root, Path(scratch))
        try:
            _measure(page, root)
        finally:
            page.process.terminate()
            page.process.wait()


def _measure(page: _Page, root: Path) -> None:
    begun = time.perf_counter()
    first = _Viewer(page)
    first.wait_for("table")
    rows = json.loads(page.ask(f"{page.one}/rows?start=0&count=100"))
    shown = time.perf_counter() - begun
    if rows["total"] != _RUNS:
        raise RuntimeError(f"{rows['total']} rows are shown")
    first.wait_for("counts")  # the journal was read to its end
    read = time.perf_counter() - begun
    time.sleep(2.0)
    spent = page.cpu_seconds
    time.sleep(_IDLE)
    idle = (page.cpu_seconds - spent) / _IDLE
    alone, busy_alone = _delays(page, root, [first])
    viewers = [first, *(_Viewer(page) for _ in range(_VIEWERS - 1))]
    for viewer in viewers[1:]:
        viewer.wait_for("means")
    many, busy = _delays(page, root, viewers)
    for viewer in viewers[1:]:
        viewer.close()
    grown = _growth(page, root)
    print_table(
        f"Live page of {_RUNS:,} runs",
        [
            Row("first rows are here", f"{shown:.2f} s", "", "", "2 s"),
            Row(f"and the journal, {(root / 'journal.jsonl').stat().st_size / 1e6:.0f} MB", f"{read:.1f} s"),
            Row("idle, one viewer", f"{100 * idle:.2f} % of a core", "", "", "1 %"),
            Row("a record is seen, one viewer", f"{median(alone):.2f} s, at most {max(alone):.2f} s", "", "", "1 s"),
            Row(
                f"a record is seen, {_VIEWERS} viewers",
                f"{median(many):.2f} s, at most {max(many):.2f} s",
                "",
                "",
                "1 s",
            ),
            Row(
                f"five records a second, 1 and {_VIEWERS} viewers",
                f"{100 * busy_alone:.0f} and {100 * busy:.0f} % of a core",
            ),
            Row(f"memory after {_MORE:,} more attempts", f"{grown[1] / 1e6:.0f} MB", f"{grown[0] / 1e6:.0f} MB before"),
        ],
    )


class _Page:
    """The page, served by a process of its own."""

    def __init__(self, root: Path, scratch: Path) -> None:
        command = [_PROGRAM, "watch", str(root), "--port", "0"]
        environment = {**os.environ, "XDG_STATE_HOME": str(scratch)}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        told = ""
        while "End" not in told and self.process.stdout is not None:
            told += self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:(\d+)/#key=(\w+)", told)
        if found is None:
            raise RuntimeError(told)
        self.port, self._key = int(found[1]), found[2]
        self._process = psutil.Process(self.process.pid)
        self.one = f"/api/experiments/{json.loads(self.ask('/api/about'))['only']}"

    def opened(self, path: str) -> http.client.HTTPConnection:
        """Return a connection on which something was asked for."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request("GET", path, headers={"Authorization": f"Bearer {self._key}"})
        return connection

    def ask(self, path: str) -> bytes:
        """Return what is answered."""
        return self.opened(path).getresponse().read()

    @property
    def cpu_seconds(self) -> float:
        """Processor time that it has used, s."""
        times = self._process.cpu_times()
        return float(times.user + times.system)

    @property
    def memory(self) -> int:
        """Its resident memory, bytes."""
        return int(self._process.memory_info().rss)


class _Viewer:
    """Somebody who looks, and notes when each run was seen to be done."""

    def __init__(self, page: _Page) -> None:
        connection = page.opened(f"{page.one}/events")
        self._socket = connection.sock
        self._stream = connection.getresponse()
        self.seen: dict[str, float] = {}
        self._names: set[str] = set()
        self._changed = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def close(self) -> None:
        """Leave; closing the stream would wait for who reads it."""
        self._socket.shutdown(socket.SHUT_RDWR)

    def wait_for(self, name: str) -> None:
        """Wait for an event of this name."""
        with self._changed:
            if not self._changed.wait_for(lambda: name in self._names, 60):
                raise TimeoutError(name)

    def _read(self) -> None:
        name = ""
        try:
            for raw in self._stream:
                now = time.perf_counter()
                if raw.startswith(b"event: "):
                    name = raw[7:].strip().decode()
                elif raw.startswith(b"data: "):
                    told = json.loads(raw[6:]) if name in {"rows", "state"} else {}
                    with self._changed:
                        self._names |= {name, *(["counts"] if "counts" in told else [])}
                        for row in told.get("rows", ()):
                            self.seen.setdefault(f"{row[1]} {row[4][0]}", now)
                        self._changed.notify_all()
        except (OSError, ValueError, AttributeError):
            return


def _delays(page: _Page, root: Path, viewers: list[_Viewer]) -> tuple[list[float], float]:
    """Return how long after each record each viewer saw it, s, and the share of a core that the page took meanwhile."""
    written: dict[str, float] = {}
    spent, begun = page.cpu_seconds, time.perf_counter()
    with (root / "journal.jsonl").open("a") as journal:
        for number in range(_RECORDS):
            run, energy = f"r_{number * 7 + 1}", 1000.0 + number + 100 * len(viewers)
            journal.write(_ended(run, energy))
            journal.flush()
            written[f"{run} {energy}"] = time.perf_counter()
            time.sleep(_EVERY)
    time.sleep(2.0)
    busy = (page.cpu_seconds - spent) / (time.perf_counter() - begun)
    delays = [viewer.seen[key] - at for viewer in viewers for key, at in written.items() if key in viewer.seen]
    if len(delays) != len(viewers) * len(written):
        raise RuntimeError(f"{len(delays)} of {len(viewers) * len(written)} were seen")
    return delays, busy


def _growth(page: _Page, root: Path) -> tuple[int, int]:
    """Return the page's memory before and after many runs were executed again, bytes."""
    sizes = []
    for part in range(3):  # the first time, what is taken once and for all is taken
        with (root / "journal.jsonl").open("a") as journal:
            journal.writelines(_ended(f"r_{number % _RUNS + 1}", float(number + part)) for number in range(_MORE))
        time.sleep(8.0)
        sizes.append(page.memory)
    return sizes[-2], sizes[-1]


def _ended(run: str, energy: float) -> str:
    measures = {"Energy": {"value": energy, "owner": "config", "origin": None}}
    facts: dict[str, Any] = {
        "run": run,
        "attempt": 1,
        "is_last": True,
        "status": "done",
        "seconds": 1.0,
        "failure": None,
    }
    record = {"kind": "attempt_finished", "at": _AT, **facts, "measures": measures, "stamps": {}}
    return json.dumps(record, separators=(",", ":")) + "\n"


def _make_experiment(root: Path) -> None:
    """Write an experiment whose runs are all done, with some 36 records for each, as the demo has."""
    root.mkdir()
    manifest = {"format": 1, "experiment_name": "large", "design": {}, "seed": 1}
    (root / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    columns = [("run_id", "progress", "string"), ("status", "progress", "string")]
    columns += [("Task", "factor", "string"), ("Energy", "measure", "number")]
    fields = [{"name": name, "type": kind, "robot_runner:role": role} for name, role, kind in columns]
    (root / "run_table.schema.json").write_text(json.dumps({"fields": fields}), encoding="utf-8")
    with (root / "run_table.csv").open("w", encoding="utf-8") as table:
        table.write("run_id,status,Task,Energy\n")
        table.writelines(f"r_{run + 1},Done,{'ABC'[run % 3]},{700 + run % 7}\n" for run in range(_RUNS))
    event = json.dumps({"kind": "event", "at": _AT, "event": "launch_mission", "clock": 1.5}, separators=(",", ":"))
    with (root / "journal.jsonl").open("w", encoding="utf-8") as journal:
        journal.write(f'{{"kind":"experiment_started","at":"{_AT}","runs":{_RUNS}}}\n')
        for run in range(_RUNS):
            journal.write(f"{event}\n" * 35 + _ended(f"r_{run + 1}", 700.0 + run % 7))


if __name__ == "__main__":
    main()
