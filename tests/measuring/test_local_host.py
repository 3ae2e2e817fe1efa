from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from tests.measuring.busy_core import (
    FAMILY,
    ZOMBIE,
    busy_core,
    busy_family,
    counted_seconds,
    late_program,
    needs_affinity,
    wait,
)
from tests.waiting import wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring import local_host
from robot_runner.measuring.cpu_counters import utilisation_of
from robot_runner.measuring.host import FileHost, HostLink, ProcessHost, ReportingSampler
from robot_runner.measuring.local_host import LocalHost

pytest.importorskip("psutil", reason="psutil samples this machine: pip install 'robot-runner[psutil]'")


@pytest.fixture
def host():
    link = LocalHost(SystemClock())
    yield link
    link.close()


def test_it_is_a_host_that_tells_of_processes_and_files(host):
    for protocol in (HostLink, ProcessHost, FileHost):
        assert isinstance(host, protocol)
    assert not host.is_simulated


@pytest.mark.long
@needs_affinity
def test_a_busy_core_reads_100_percent_and_its_process_what_the_kernel_says(host):
    with busy_core() as busy:
        begun = time.monotonic()
        sampler = host.sample_processes(10.0, [f"pid:{busy.pid}"])
        spent = -busy.cpu_seconds
        wait(1.5)
        samples = sampler.stop()
        spent += busy.cpu_seconds
        unseen = time.monotonic() - begun - (samples[-1].time - samples[0].time)  # before and after the samples
    spans = [(late.time - soon.time, late) for soon, late in pairwise(samples) if late.cores[busy.core] is not None]
    mean = sum(span * late.cores[busy.core] for span, late in spans) / sum(span for span, _ in spans)
    assert mean == pytest.approx(100.0, abs=2.0)
    assert spent - unseen - 0.12 <= counted_seconds(samples) <= spent + 0.12


@pytest.mark.long
def test_children_of_a_subject_that_come_and_go_between_two_looks_are_counted(host):
    with busy_family() as busy:
        begun = time.monotonic()
        sampler = host.sample_processes(10.0, [f"subject:{FAMILY}"])
        spent = -busy.cpu_seconds
        wait(1.2)
        samples = sampler.stop()
        spent += busy.cpu_seconds
        unseen = time.monotonic() - begun - (samples[-1].time - samples[0].time)  # before and after the samples
    assert spent - unseen - 0.2 <= counted_seconds(samples) <= spent + 0.2


@pytest.mark.long
def test_a_child_that_is_awaited_long_after_it_has_ended_counts_once(host, monkeypatch):
    monkeypatch.setattr(local_host, "SCAN", 0.0)
    monkeypatch.setattr(local_host, "YOUNG", 1000.0)
    with busy_family(program=ZOMBIE) as busy:
        sampler = host.sample_processes(20.0, [f"subject:{FAMILY}"])
        busy.wait_for_children(0.3)
        wait(0.2)
        samples = sampler.stop()
        spent = busy.cpu_seconds
    assert counted_seconds(samples) == pytest.approx(spent, abs=0.2)


def test_a_process_that_is_new_is_seen_by_the_next_sample(monkeypatch):
    psutil = pytest.importorskip("psutil")
    monkeypatch.setattr(local_host, "SCAN", 0.0)
    processes = local_host.LocalProcesses(psutil, [f"subject:{FAMILY}"])
    assert processes.counters() == ()
    with busy_family() as busy:
        assert busy.pid in [one.pid for one in processes.counters()]


@pytest.mark.skipif(not Path("/proc").exists(), reason="what a process has become is read in Linux's /proc")
def test_a_script_that_turns_into_a_program_is_seen_by_the_next_sample(monkeypatch, tmp_path):
    psutil = pytest.importorskip("psutil")
    monkeypatch.setattr(local_host, "SCAN", 0.0)
    with late_program(tmp_path) as (name, pid, turn):
        processes = local_host.LocalProcesses(psutil, [f"name:{name}"])
        for _ in range(6):
            assert processes.counters() == ()
        turn()
        assert [one.pid for one in processes.counters()] == [pid]


@pytest.mark.skipif(not Path("/proc").exists(), reason="what a process has become is read in Linux's /proc")
def test_a_script_that_turns_into_a_program_is_seen_also_where_the_computers_clock_was_set(monkeypatch, tmp_path):
    psutil = pytest.importorskip("psutil")
    monkeypatch.setattr(local_host, "SCAN", 0.0)
    monkeypatch.setattr(local_host, "YOUNG", 1000.0)
    processes = local_host.LocalProcesses(psutil, [f"name:late{os.getpid()}"])
    assert processes.counters() == ()
    # psutil before version 7 keeps to the boot time that it read first: of a clock that is set, all seems to be old.
    begun = psutil.Process.create_time
    monkeypatch.setattr(psutil.Process, "create_time", lambda process: begun(process) - 3600.0)
    with late_program(tmp_path) as (_, pid, turn):
        assert processes.counters() == ()
        turn()
        assert [one.pid for one in processes.counters()] == [pid]


def test_what_a_subject_has_started_belongs_to_it_where_its_mark_was_taken_away(host):
    with busy_family("sh", "-c", 'env -i "$@"; true', "sh"):
        sampler = host.sample_processes(10.0, [f"subject:{FAMILY}"])
        wait(0.5)
        assert sampler.stop()[-1].processes[0].count >= 2  # the shell, and what sudo would have started


def test_samples_are_on_the_runs_clock_and_say_how_they_were_taken(host):
    begun = SystemClock().now()
    sampler = host.sample_utilisation(50.0)
    wait(0.3)
    samples = sampler.stop()
    assert begun <= samples[0].time <= samples[-1].time <= SystemClock().now()
    assert samples[0].host_time is None
    assert all(0.0 < sample.memory < 100.0 for sample in samples)
    assert isinstance(sampler, ReportingSampler)
    report = sampler.report()
    assert (report.rate, report.clock, report.problems) == (50.0, None, ())
    assert 0.0 < report.cpu_seconds < 0.3
    assert sampler.stop() is samples


def test_this_very_process_is_found_by_its_number(host):
    sampler = host.sample_processes(20.0, [f"pid:{os.getpid()}", "name:nobody_is_called_so"])
    wait(0.2)
    here, nobody = sampler.stop()[-1].processes
    assert (here.count, nobody.count) == (1, 0)
    assert here.memory > 0.0
    assert nobody.memory == 0.0


@pytest.fixture
def jetson(monkeypatch, tmp_path):
    """A machine of six cores of which 1 and 2 are switched off, as on a Jetson TX2, and psutil's view of it."""
    times = {core: SimpleNamespace(user=100.0 * core, idle=1000.0) for core in range(6)}
    online = [0, 3, 4, 5]

    class Times(NamedTuple):
        user: float
        idle: float

    def cpu_times(*, percpu=False):
        there = [Times(times[core].user, times[core].idle) for core in online]
        everything = Times(sum(each.user for each in times.values()), sum(each.idle for each in times.values()))
        return there if percpu else everything

    fake = SimpleNamespace(
        cpu_times=cpu_times,
        cpu_count=lambda: len(online),
        virtual_memory=lambda: SimpleNamespace(total=8e9, available=6e9),
    )
    listed = tmp_path / "online"
    listed.write_text("0,3-5\n", encoding="ascii")
    monkeypatch.setitem(sys.modules, "psutil", fake)
    monkeypatch.setattr(local_host, "_ONLINE", str(listed))
    return SimpleNamespace(times=times, online=online, listed=listed)


def test_cores_keep_their_numbers_where_others_are_switched_off(jetson):
    counters = local_host._Counters(()).read()
    assert [core and core.total for core in counters.cores] == [1000.0, None, None, 1300.0, 1400.0, 1500.0]


def test_a_core_that_is_switched_off_does_not_move_the_utilisation_of_all(jetson):
    counters = local_host._Counters(())
    looks = [counters.read()]
    for core in jetson.online:
        jetson.times[core].idle += 10.0
    jetson.online.remove(4)
    jetson.listed.write_text("0,3,5\n", encoding="ascii")
    looks.append(counters.read())
    told = utilisation_of([replace(look, time=float(at)) for at, look in enumerate(looks)], cores=4)
    assert [one.cpu for one in told] == [None, 0.0]


def test_a_list_of_cores_that_says_something_else_leaves_them_in_their_order(jetson):
    jetson.listed.write_text("0-5\n", encoding="ascii")
    assert len(local_host._Counters(()).read().cores) == 4
    jetson.listed.unlink()
    assert len(local_host._Counters(()).read().cores) == 4


def test_a_process_stays_the_same_where_the_computers_clock_is_set(monkeypatch):
    psutil = pytest.importorskip("psutil")
    booted = iter(range(1_700_000_000, 1_700_001_000))
    monkeypatch.setattr("psutil._pslinux.boot_time", lambda: float(next(booted)), raising=False)
    monkeypatch.setattr(local_host, "SCAN", 0.0)
    processes = local_host.LocalProcesses(psutil, [f"pid:{os.getpid()}"])
    assert len({one.started for _ in range(4) for one in processes.counters()}) == 1


def test_files_are_read_at_the_rate(host, tmp_path):
    (tmp_path / "power").write_text("7500\nmore\n")
    sampler = host.sample_files(50.0, [str(tmp_path / "power"), str(tmp_path / "nothing")])
    wait_until(lambda: len(sampler._sampler._times) > 4)
    samples = sampler.stop()
    assert len(samples) >= 5
    assert {sample.lines for sample in samples} == {("7500", None)}
    assert host.list_files(f"{tmp_path}/p*") == [str(tmp_path / "power")]


def test_a_link_that_is_closed_samples_no_more(host):
    sampler = host.sample_utilisation(10.0)
    host.close()
    host.close()
    assert sampler.stop()
    with pytest.raises(LinkError, match="was closed"):
        host.sample_utilisation(10.0)


def test_without_psutil_it_says_how_to_get_it(host, monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(local_host, "import_module", missing)
    with pytest.raises(LinkError, match="psutil cannot be imported") as raised:
        host.sample_utilisation(10.0)
    assert "robot-runner[psutil]" in raised.value.fix
