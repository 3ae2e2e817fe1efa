from __future__ import annotations

import csv
import json
import random
import sys
from itertools import accumulate

import numpy as np
import pytest
from tests.meters.fake_nvidia_driver import DRIVER_NOT_LOADED, FakeGpu, FakeNvidiaDriver, install
from tests.meters.rehearsed import problems

from robot_runner.core.errors import PluginError
from robot_runner.plugins import Circumstances
from robot_runner.plugins.profilers import Nvml
from robot_runner.testing import FakeClock, ProfilerContract, make_context, rehearse

pytest.importorskip("pynvml", reason="nvidia-ml-py is not installed")


class TestNvmlOnAFakeDriver(ProfilerContract):
    robot = None

    @pytest.fixture(autouse=True)
    def _driver(self, monkeypatch):
        install(FakeNvidiaDriver(FakeClock(), [FakeGpu(), FakeGpu()]), monkeypatch)

    def make_plugin(self) -> Nvml:
        return Nvml()


@pytest.fixture
def clock():
    return FakeClock(10.0)


@pytest.fixture
def measure(tmp_path, clock, monkeypatch):
    def execute(*gpus, seconds=20.0, **settings):
        driver = install(FakeNvidiaDriver(clock, list(gpus)), monkeypatch)
        plugin = Nvml(**settings)
        context = make_context(tmp_path, plugin, robot=None, clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        assert driver.open_count == 0
        return context

    return execute


def test_all_gpus_are_added_up(measure):
    context = measure(FakeGpu(50.0, utilisation=40), FakeGpu(30.0, utilisation=80, memory_used=6 << 30))
    assert context.measures["Energy"] == pytest.approx(1600.0)
    assert context.measures["MeanPower"] == pytest.approx(80.0)
    assert context.measures["GPU"] == pytest.approx(60.0)
    assert context.measures["GPUMemory"] == pytest.approx(50.0)
    assert problems(context) == []


def test_gpus_can_be_chosen(measure):
    context = measure(FakeGpu(50.0), FakeGpu(30.0), gpus=[1])
    assert context.measures["MeanPower"] == pytest.approx(30.0)


def test_without_a_counter_energy_is_the_integral_of_power(measure):
    context = measure(FakeGpu(lambda time: time, has_counter=False))
    assert context.measures["Energy"] == pytest.approx((30.0**2 - 10.0**2) / 2)
    with (context.raw_data_folder / "samples.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    assert (row["gpu0_power_W"], row["gpu0_energy_J"]) == ("10.000", "")


def test_a_counter_that_stands_still_is_told_and_power_takes_its_place(measure):
    context = measure(FakeGpu(50.0, counts=False, utilisation=0))
    assert context.measures["Energy"] == pytest.approx(1000.0)
    assert problems(context) == ["the energy counter of GPU 0 stood still: its energy is the integral of its power"]


def test_a_counter_that_was_set_back_and_passed_its_beginning_again_gives_way_to_power(measure, clock):
    gpu = FakeGpu(lambda time: 50.0 if time < 15.0 else 100.0, utilisation=0)
    clock.at(15.0, lambda: setattr(gpu, "offset", 3_900_000))
    context = measure(gpu)
    assert context.measures["Energy"] == pytest.approx(5 * 50.0 + 15 * 100.0, rel=0.01)
    assert problems(context) == ["the energy counter of GPU 0 was set back: its energy is the integral of its power"]


@pytest.mark.parametrize(
    ("millijoules", "rise"),
    [
        (lambda time: 50_000 * min(time, 20.0), "500"),  # it stands still half way
        (lambda time: 50.0 * time, "1"),  # it counts in J
        (lambda time: 28_500 * time, "570"),  # as a real one did: ml-energy/zeus, issue 181
    ],
)
def test_a_counter_that_its_power_contradicts_is_doubted(measure, millijoules, rise):
    context = measure(FakeGpu(50.0), FakeGpu(50.0, millijoules=millijoules))
    assert problems(context) == [f"the energy counter of GPU 1 rose by {rise} J, and its power amounts to 1000 J"]


def test_power_that_is_an_average_over_the_last_second_does_not_contradict_the_counter(measure):
    def watts(time):  # 500 W from 17 s on, as the GPU tells it
        return 100.0 + 400.0 * min(max(time - 17.0, 0.0), 1.0)

    def millijoules(time):
        return 1000 * (100.0 * time + 400.0 * max(time - 17.0, 0.0))

    context = measure(FakeGpu(watts, millijoules=millijoules), seconds=7.5)
    assert context.measures["Energy"] == pytest.approx(750.0 + 200.0)
    assert problems(context) == []


@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_bursts_that_power_of_a_moment_misses_do_not_contradict_the_counter(measure, rate_hz):
    chance = random.Random(7)  # noqa: S311 - reproducible, not secret
    watts = [chance.choice((8.0, 300.0)) for _ in range(1000)]  # an A100 tells the power of a moment
    joules = [0.0, *accumulate(0.1 * each for each in watts)]

    def millijoules(time):
        return 1000 * joules[int(time * 10 + 1e-6)]

    context = measure(
        FakeGpu(lambda time: watts[int(time * 10 + 1e-6)], millijoules=millijoules), seconds=60.0, rate_hz=rate_hz
    )
    assert context.measures["Energy"] == pytest.approx(joules[700] - joules[100])
    assert problems(context) == []


def test_a_mission_that_is_short_beside_the_renewals_of_the_counter_is_doubted(measure):
    def millijoules(time):  # it is brought up to date every 0.1 s, and at other moments than it is read
        return 5_000_000 + 300_000 * (int(time * 10 + 0.55) / 10)

    (problem,) = problems(measure(FakeGpu(300.0, millijoules=millijoules), seconds=0.2))
    assert problem == "GPU 0 renews its energy counter every 0.1 s or so: over 0.200 s, its energy may be off by 50 %"
    assert problems(measure(FakeGpu(300.0, millijoules=millijoules), seconds=4.0)) == []


def test_a_gpu_that_computes_and_tells_the_same_power_all_along_may_be_stuck(measure):
    def frozen(time):
        return 50.0 + 0.1 * (round(min(time, 25.0) * 10) % 7)

    (problem,) = problems(measure(FakeGpu(frozen, has_counter=False)))
    assert problem == "GPU 0 reported the same power 51 times, for 5.0 s, while it computed: it may be stuck"
    assert problems(measure(FakeGpu(frozen, has_counter=False, utilisation=0))) == []


def test_a_gpu_that_tells_no_power_at_all_is_doubted(measure):
    assert "GPU 0 reported a power of 0 W throughout" in problems(
        measure(FakeGpu(0.0, has_counter=False, utilisation=0))
    )


def test_power_that_changes_between_readings_bends_an_energy_that_no_counter_tells(measure):
    def spike(time):
        return 4_294_967.295 if 20.05 < time < 20.15 else 50.0

    assert any(
        "of GPU 0 changed between samples" in each for each in problems(measure(FakeGpu(spike, has_counter=False)))
    )


def test_power_that_a_gpu_seldom_renews_is_doubted(measure):
    def told(time):
        return 50.0 + 7 * int(time / 2.0) % 3

    context = measure(FakeGpu(told, has_counter=False))
    assert any("renews its power of GPU 0 every 2.0 s only" in each for each in problems(context))


def test_a_gpu_that_is_lost_half_way_costs_the_values_and_not_the_run(measure, clock):
    gpu = FakeGpu()
    clock.at(15.0, lambda: setattr(gpu, "is_lost", True))
    context = measure(gpu)
    assert set(context.measures.values()) == {None}
    assert any("GPU is lost" in problem for problem in problems(context))


def test_power_that_was_told_for_a_part_of_the_time_is_not_taken_for_all_of_it(measure, clock):
    gpu = FakeGpu(50.0, has_counter=False)
    clock.at(15.0, lambda: setattr(gpu, "has_power", False))
    context = measure(gpu)
    assert context.measures["Energy"] is None
    assert context.measures["GPU"] == 40.0
    (problem,) = problems(context)
    assert problem.startswith("the power of GPU 0 was reported in 5")
    assert problem.endswith("of 201 readings only")


def test_a_gpu_that_is_lost_shortly_before_the_end_has_used_no_less(measure, clock):
    gpu = FakeGpu(50.0, has_counter=False)
    clock.at(29.15, lambda: setattr(gpu, "is_lost", True))
    assert measure(gpu).measures["Energy"] == pytest.approx(1000.0)


def test_the_names_of_the_gpus_are_kept(measure):
    context = measure(FakeGpu())
    assert json.loads((context.raw_data_folder / "quality.json").read_text())["gpus"] == ["NVIDIA Fake"]


def test_a_machine_without_the_driver_is_refused(monkeypatch, clock):
    install(FakeNvidiaDriver(clock, [], init_error=DRIVER_NOT_LOADED), monkeypatch)
    (finding,) = Nvml().check(Circumstances())
    assert finding.is_error
    assert "driver does not answer: Driver Not Loaded" in finding.problem
    assert "nvidia-smi" in finding.fix


def test_a_gpu_that_is_not_there_is_told(monkeypatch, clock):
    install(FakeNvidiaDriver(clock, [FakeGpu()]), monkeypatch)
    (finding,) = Nvml(gpus=[1]).check(Circumstances())
    assert finding.problem == "there is no GPU 1; there are 1, counted from 0"
    assert list(Nvml().check(Circumstances())) == []


def test_a_machine_without_the_library_is_told_which_extra_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pynvml", None)
    (finding,) = Nvml().check(Circumstances())
    assert "robot-runner[nvml]" in finding.fix


@pytest.mark.parametrize("gpus", [np.array([1, 0]), iter([1, 0]), [np.int64(1), 0]])
def test_numbers_of_gpus_may_come_from_numpy_or_an_iterator(gpus):
    assert Nvml(gpus=gpus).gpus == (1, 0)


@pytest.mark.parametrize(
    "settings",
    [*({"gpus": gpus} for gpus in ([], [-1], ["0"], [0.5], [True], [[0]])), {"rate_hz": 0.0}],
)
def test_what_cannot_be_is_refused(settings):
    with pytest.raises(PluginError):
        Nvml(**settings)
