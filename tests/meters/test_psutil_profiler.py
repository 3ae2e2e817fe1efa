from __future__ import annotations

import csv
import json
from subprocess import CompletedProcess

import pytest
from tests.meters.rehearsed import problems

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.measure import Origin
from robot_runner.core.links import ssh_command
from robot_runner.measuring.host import ProcessUtilisation, SamplingReport
from robot_runner.measuring.on_board_session import FORMS
from robot_runner.measuring.utilisation import Selection, Utilisation
from robot_runner.plugins import Circumstances, Window
from robot_runner.plugins.profilers import PsUtil
from robot_runner.testing import (
    FakeClock,
    FakeHostLink,
    FakeLinks,
    ProfilerContract,
    UtilisationSample,
    make_context,
    rehearse,
)


class TestPsUtilOnTheSimulatedRobot(ProfilerContract):
    def make_plugin(self) -> PsUtil:
        return PsUtil()


class TestPsUtilOnAScriptedComputer(ProfilerContract):
    def make_plugin(self) -> PsUtil:
        return PsUtil(rate_hz=20.0)

    def make_links(self, clock: FakeClock) -> FakeLinks:
        return FakeLinks(host=FakeHostLink(clock, cpu=lambda time: 10.0 + time, memory=25.0))


@pytest.fixture
def measure(tmp_path):
    def execute(*, seconds=10.0, **script):
        clock, profiler = FakeClock(50.0), PsUtil()
        links = FakeLinks(host=FakeHostLink(clock, **script))
        context = make_context(tmp_path, profiler, links=links, clock=clock)
        rehearse(context, profiler, mission=lambda: clock.sleep(seconds))
        return context

    return execute


def test_means_are_those_of_the_measured_window(measure):
    context = measure(cpu=lambda time: 80.0 if time > 57.05 else 20.0, memory=lambda time: time)
    assert context.measures["CPU"] == pytest.approx((20.0 * 7.0 + 80.0 * 3.0) / 10)
    assert context.measures["Memory"] == pytest.approx(55.0)
    assert problems(context) == []


def test_a_busy_moment_weighs_by_its_time_where_samples_are_missing(measure):
    context = measure(
        cpu=lambda time: 100.0 if time < 55.05 else 0.0,
        misses=lambda time: time < 55.05 and round(10 * time) % 2 == 1,
    )
    assert context.measures["CPU"] == pytest.approx(50.0)


def test_missing_samples_are_told(measure):
    context = measure(misses=lambda time: 52.0 < time < 52.45)
    assert "97 samples arrived of 100 expected" in problems(context)
    assert context.measures["CPU"] is not None


def test_a_computer_that_was_silent_for_long_yields_no_value(measure):
    context = measure(misses=lambda time: time > 56.0)
    assert dict(context.measures) == {"CPU": None, "Memory": None}
    assert any("the largest gap" in problem for problem in problems(context))


def test_a_computer_that_said_nothing_yields_no_value(measure):
    context = measure(misses=lambda _: True)
    assert dict(context.measures) == {"CPU": None, "Memory": None}
    assert problems(context) == ["no sample arrived in the measured window, where 100 were expected"]


def test_samples_that_cannot_be_fetched_leave_a_warning_and_the_run_alive(tmp_path):
    class CutOff(FakeHostLink):
        def sample_at(self, time):
            raise LinkError(f"no route to the host since {time:g} s", fix="Look at the network.")

    clock, profiler = FakeClock(), PsUtil()
    context = make_context(tmp_path, profiler, links=FakeLinks(host=CutOff(clock)), clock=clock)
    measures = rehearse(context, profiler, mission=lambda: clock.sleep(2.0))
    assert dict(measures) == {"CPU": None, "Memory": None}
    assert problems(context)[0] == "the samples could not be fetched: no route to the host since 0 s"


def test_a_run_that_was_never_measured_publishes_no_values(tmp_path):
    profiler = PsUtil()
    context = make_context(tmp_path, profiler, links=FakeLinks())
    profiler.populate_run_data(context)
    assert dict(context.measures) == {"CPU": None, "Memory": None}
    assert problems(context) == ["nothing was measured: the measurement was never started"]


@pytest.mark.parametrize(("is_simulated", "origin"), [(True, Origin.SIMULATED), (False, Origin.MEASURED)])
def test_utilisation_says_where_it_comes_from(measure, is_simulated, origin):
    context = measure(is_simulated=is_simulated)
    assert {published.origin for published in context.broker.measures.values()} == {origin}


def test_raw_samples_and_their_quality_are_kept(measure):
    context = measure(cpu=12.5, memory=24.0, is_simulated=True)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 101
    assert rows[0] == {"time_s": "50.000000", "cpu_percent": "", "memory_percent": "24.000"}
    assert rows[1] == {"time_s": "50.100000", "cpu_percent": "12.500", "memory_percent": "24.000"}
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert (facts["samples"]["expected"], facts["is_simulated"]) == (100, True)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("inf"), float("nan")])
def test_a_rate_that_cannot_be_is_refused(rate):
    with pytest.raises(PluginError, match="rate_hz is"):
        PsUtil(rate_hz=rate)


def test_without_a_host_and_a_simulated_robot_the_check_says_how_to_name_one():
    (finding,) = PsUtil().check(Circumstances())
    assert finding.is_error
    assert "host='localhost'" in finding.fix
    assert "--set robot=simulated" in finding.fix


def test_the_computer_of_a_simulated_robot_tells_of_no_processes():
    (finding,) = PsUtil(processes=["talker"]).check(Circumstances(robot="simulated"))
    assert finding.is_error
    assert "does not report single processes" in finding.problem


def test_this_machine_is_no_simulated_robots_computer():
    (finding,) = PsUtil(host="localhost").check(Circumstances(robot="simulated"))
    assert not finding.is_error
    assert "measures the machine that simulates it" in finding.problem


def test_without_psutil_the_check_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    (finding,) = PsUtil(host="localhost").check(Circumstances())
    assert finding.is_error
    assert "robot-runner[psutil]" in finding.fix


def test_a_host_that_ssh_cannot_reach_is_refused_by_the_check(monkeypatch):
    refused = CompletedProcess([], 255, b"", b"ssh: Could not resolve hostname turtle")
    monkeypatch.setattr(ssh_command, "execute", lambda _, timeout: refused)
    monkeypatch.setattr(ssh_command.shutil, "which", lambda _: "/usr/bin/ssh")
    (finding,) = PsUtil(host="pi@turtle").check(Circumstances())
    assert finding.is_error
    assert "pi@turtle cannot be reached" in finding.problem


def test_processes_that_a_run_may_start_refuse_no_experiment_before_it():
    plugin = PsUtil(host="localhost", processes=["subject:Nav", "move_base", 4711, "node:/talker"])
    assert list(plugin.not_probed) == [
        "CPU_Nav",
        "Memory_Nav",
        "CPU_move_base",
        "Memory_move_base",
        "CPU_talker",
        "Memory_talker",
    ]


def test_a_form_that_looks_once_a_second_is_probed_for_more_than_two_looks():
    assert PsUtil(host="pi@robot", form="ps").probe_s > 2 > PsUtil(host="pi@robot").probe_s


def test_each_process_and_each_core_has_measures_of_its_own():
    plugin = PsUtil(host="localhost", processes=["move_base", 4711, "node:/talker"], cores=[0, 3])
    assert [measure.name for measure in plugin.measures] == [
        "CPU",
        "Memory",
        "CPU_core0",
        "CPU_core3",
        "CPU_move_base",
        "Memory_move_base",
        "CPU_4711",
        "Memory_4711",
        "CPU_talker",
        "Memory_talker",
    ]
    assert [measure.name for measure in PsUtil.measures] == ["CPU", "Memory"]


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"processes": "talker"}, "processes is 'talker'"),
        ({"processes": ["nod:/talker"]}, "selects no process"),
        ({"processes": ["name:talker", "node:/talker"]}, "two of the processes"),
        ({"cores": [-1]}, "no core -1"),
        ({"cores": [True]}, "no core True"),
        ({"form": "perl"}, "form is 'perl'"),
        ({"form": "sh"}, "form is 'sh', and the computer is not reached by ssh"),
        ({"host": "localhost", "is_streamed": True}, "is_streamed is True"),
        ({"host": "pi@robot", "namespace": "/alice"}, "namespace is '/alice', and a host is named"),
    ],
)
def test_parameters_that_cannot_be_are_refused(parameters, problem):
    with pytest.raises(PluginError, match=problem) as raised:
        PsUtil(**parameters)
    assert raised.value.fix


def test_samples_without_a_cpu_share_leave_their_time_to_the_next_one():
    samples = [UtilisationSample(0.0, None, 10.0)]
    samples += [UtilisationSample(at, cpu, 10.0) for at, cpu in ((1.0, 50.0), (1.5, None), (2.0, 100.0))]
    measured = Utilisation(samples, Window(0.0, 2.0), Selection(), SamplingReport(rate=1.0), is_simulated=False)
    assert measured.means() == {"CPU": pytest.approx(75.0), "Memory": pytest.approx(10.0)}


def test_a_process_that_was_never_there_has_no_value_and_is_told_of():
    nobody = (ProcessUtilisation(0, None, 0.0),)
    samples = [UtilisationSample(float(at), 50.0, 10.0, processes=nobody) for at in range(3)]
    selection = Selection(("name:talker",), (7,))
    measured = Utilisation(samples, Window(0.0, 2.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    assert measured.means()["CPU_talker"] is None
    assert measured.means()["CPU_core7"] is None
    assert [each.problem for each in measured.doubted()] == [
        "no process name:talker was seen; new ones are looked for once a second",
        "the computer reports no core 7",
    ]


def test_what_ps_cannot_tell_is_doubted():
    samples = [UtilisationSample(float(at), 50.0, 10.0) for at in range(3)]
    report = SamplingReport(rate=1.0, form=FORMS["ps"].description)
    seconds, resident = Utilisation(samples, Window(0.0, 2.0), Selection(), report, is_simulated=False).doubted()
    assert seconds.problem.startswith(
        "ps reports CPU time in whole seconds: over 2.0 s, utilisation may be off by 50 %"
    )
    assert resident.problem.startswith("ps reports the memory of processes only")
    assert resident.measures == ("Memory",)


def test_what_is_doubted_of_one_process_or_core_leaves_the_others_and_the_whole_computer_undoubted():
    there = ProcessUtilisation(1, 5.0, 1.0)
    samples = [
        UtilisationSample(float(at), 50.0, 10.0, processes=(ProcessUtilisation(0, None, 0.0), there)) for at in range(3)
    ]
    selection = Selection(("name:talker", "name:listener"), (7,))
    measured = Utilisation(samples, Window(0.0, 2.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    assert [each.measures for each in measured.doubted()] == [("CPU_talker", "Memory_talker"), ("CPU_core7",)]
    assert all(each.fix for each in measured.doubted())
    doubted = {name for each in measured.doubted() for name in each.measures}
    assert doubted <= {one.name for one in selection.measures()}


def test_a_process_that_ended_before_the_mission_is_told_of():
    def seen(at):
        return (ProcessUtilisation(1 if at < 2 else 0, 5.0 if at < 2 else 0.0, 0.0),)

    samples = [UtilisationSample(float(at), 50.0, 10.0, processes=seen(at)) for at in range(6)]
    selection = Selection(("name:talker",))
    measured = Utilisation(samples, Window(2.0, 5.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    told = "no process name:talker was there in the measured window, only before or after it"
    assert [each.problem for each in measured.doubted()] == [told]


def ending(at, *, ended=0, reaped=0, brief=0, parents=0):
    processes = (ProcessUtilisation(1, 5.0, 0.0, ended, reaped, brief, parents),)
    return UtilisationSample(float(at), 50.0, 10.0, processes=processes)


def test_cpu_time_that_ended_processes_used_unseen_is_told_of_where_it_may_be_more_than_1_percent():
    samples = [ending(0), ending(1, ended=1), *map(ending, range(2, 201))]
    selection = Selection(("subject:Nav",))
    measured = Utilisation(samples, Window(0.0, 200.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    assert [each.problem for each in measured.doubted(["Nav"])] == []
    assert [each.problem for each in measured.over(Window(0.0, 50.0)).doubted(["Nav"])] == [
        "1 process subject:Nav ended after its last sample: CPU_Nav may leave out up to 2.0 % of a core"
    ]
    assert [each.problem for each in measured.over(Window(50.0, 100.0)).doubted(["Nav"])] == []


def test_children_that_may_have_ended_unseen_with_software_under_test_are_told_of():
    samples = [ending(0), ending(1, ended=1, parents=1), *map(ending, range(2, 51))]
    selection = Selection(("subject:Nav",))
    measured = Utilisation(samples, Window(0.0, 50.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    (told,) = [each.problem for each in measured.doubted(["Nav"])]
    assert told.endswith("CPU_Nav may leave out up to 4.0 % of a core")


def test_processes_that_came_and_went_are_told_of_as_others_may_never_have_been_seen():
    samples = [ending(0), ending(1, ended=1, brief=1), *map(ending, range(2, 201))]
    selection = Selection(("name:gcc",))
    measured = Utilisation(samples, Window(0.0, 200.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    (told,) = [each.problem for each in measured.doubted()]
    assert told.startswith("1 process name:gcc lasted less than 2 s: new ones are looked for once a second")
    assert told.endswith("CPU_gcc and Memory_gcc may be too low")


def test_how_often_new_processes_are_looked_for_is_that_of_the_sampler():
    nobody = (ProcessUtilisation(0, None, 0.0),)
    samples = [UtilisationSample(at / 20, 50.0, 10.0, processes=nobody) for at in range(41)]
    report = SamplingReport(rate=20.0, rescan=0.05)
    measured = Utilisation(samples, Window(0.0, 2.0), Selection(("name:talker",)), report, is_simulated=False)
    assert [each.problem for each in measured.doubted()] == [
        "no process name:talker was seen; new ones are looked for every 0.05 s"
    ]


def test_memory_of_a_process_that_may_have_been_there_before_it_was_seen_is_doubted():
    def told(rescan, *, since=15):
        seen = [ProcessUtilisation(1, 5.0, 2.0) if at >= since else ProcessUtilisation(0, 0.0, 0.0) for at in range(41)]
        samples = [UtilisationSample(at / 10, 50.0, 10.0, processes=(one,)) for at, one in enumerate(seen)]
        report = SamplingReport(rate=10.0, rescan=rescan)
        measured = Utilisation(samples, Window(0.0, 4.0), Selection(("subject:Nav",)), report, is_simulated=False)
        return list(measured.doubted(["Nav"]))

    (doubt,) = told(1.0)
    seen_late = "subject:Nav may have been there before it was seen: Memory_Nav may lack up to 35 %"
    assert doubt.problem == f"{seen_late}; new ones are looked for once a second"
    assert doubt.measures == ("Memory_Nav",)
    assert told(0.1) == []  # each sample looks
    assert told(1.0, since=0) == []  # it was there from the start


def test_children_of_software_under_test_that_came_and_went_are_counted_by_their_parents():
    samples = [ending(0), ending(1, ended=1, reaped=1, brief=1), ending(2)]
    selection = Selection(("subject:Nav",))
    measured = Utilisation(samples, Window(0.0, 2.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    assert [each.problem for each in measured.doubted(["Nav"])] == []


def test_a_core_that_was_switched_off_for_a_part_of_the_window_has_no_value_and_is_told_of():
    cores = [(None, None)] + [(20.0, None if 3 <= at < 13 else 90.0) for at in range(1, 21)]
    samples = [UtilisationSample(float(at), 50.0, 10.0, cores=told) for at, told in enumerate(cores)]
    selection = Selection((), (0, 1))
    measured = Utilisation(samples, Window(0.0, 20.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    assert (measured.means()["CPU_core0"], measured.means()["CPU_core1"]) == (pytest.approx(20.0), None)
    told = "the computer reports core 1 for a part of the window only: it was switched off meanwhile"
    assert [each.problem for each in measured.doubted()] == [told]


def test_a_core_that_is_switched_off_among_others_is_told_of():
    samples = [UtilisationSample(float(at), 50.0, 10.0, cores=(50.0, None, 50.0)) for at in range(3)]
    selection = Selection((), (1,))
    measured = Utilisation(samples, Window(0.0, 2.0), selection, SamplingReport(rate=1.0), is_simulated=False)
    assert measured.means()["CPU_core1"] is None
    assert [each.problem for each in measured.doubted()] == ["the computer reports no core 1"]


def test_a_core_that_is_switched_off_has_no_column_among_the_samples(tmp_path):
    samples = [UtilisationSample(0.0, None, 10.0, cores=(None, None, None))]
    samples += [UtilisationSample(float(at), 50.0, 10.0, cores=(50.0, None, 50.0)) for at in (1, 2)]
    measured = Utilisation(samples, Window(0.0, 2.0), Selection(), SamplingReport(rate=1.0), is_simulated=False)
    measured.write(tmp_path, None)
    heading = (tmp_path / "samples.csv").read_text(encoding="ascii").splitlines()[0]
    assert heading == "time_s,cpu_percent,memory_percent,cpu_core0_percent,cpu_core2_percent"
