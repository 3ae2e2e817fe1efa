from __future__ import annotations

import json
import math
import random
from itertools import accumulate

import pytest

from robot_runner.core.events.measure import Measure, Over
from robot_runner.meters.electrical import ElectricalProfiler
from robot_runner.meters.electrical_readings import ElectricalReading
from robot_runner.testing import FakeClock, make_context, rehearse


class ScriptedMeter(ElectricalProfiler):
    """Says what a function of time says."""

    def __init__(self, say, rate_hz=10.0, channels=("",)):
        super().__init__(name="Meter", rate_hz=rate_hz, channels=channels)
        self._say = say

    def open(self, context):
        self._clock = context.clock
        return self

    def read(self):
        said = self._say(self._clock.now())
        return (said,) if isinstance(said, ElectricalReading) else said

    def close(self):
        pass


def test_what_the_energy_was_taken_from_is_told_of_the_mission_and_not_of_the_time_around_it(tmp_path):
    clock = FakeClock()
    plugin = ScriptedMeter(lambda time: ElectricalReading(8.0, wobbling(time), joules=8.0 * (time % 15.0)))
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    clock.sleep(14.0)
    plugin.start_run(context)
    plugin.start_measurement(context)
    clock.sleep(2.0)  # the counter is set back before the mission
    context.times.begin()
    clock.sleep(10.0)
    context.times.end()
    plugin.stop_measurement(context)
    plugin.populate_run_data(context)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert [finding.problem for finding in context.broker.findings] == []
    assert facts["energy_from"] == {"": "counter"}


class MeterOfTwo(ScriptedMeter):
    """Has measures of its own, of which one of the base's is no part."""

    def __init__(self):
        super().__init__(lambda time: ElectricalReading(6.0 + wobbling(time), 12.0, 0.5))
        peak = Measure("PeakPower", "W", "Largest power of the mission.", over=Over.MAXIMUM)
        self.measures = (peak, *self.measures[:2])

    def values(self, sampling):
        return {**super().values(sampling), "PeakPower": max(reading[0].power for reading in sampling.readings)}


def test_a_meter_may_have_measures_of_its_own_and_leave_out_those_of_the_base(tmp_path):
    clock, plugin = FakeClock(), MeterOfTwo()
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    measures = rehearse(context, plugin, mission=lambda: clock.sleep(10.0))
    assert list(measures) == ["PeakPower", "Energy", "MeanPower"]
    assert measures["Energy"] == pytest.approx(10 * measures["MeanPower"])
    assert measures["PeakPower"] >= measures["MeanPower"]


@pytest.fixture
def measure(tmp_path):
    def execute(say, seconds=10.0, **settings):
        clock, plugin = FakeClock(), ScriptedMeter(say, **settings)
        context = make_context(tmp_path, plugin, robot=None, clock=clock)
        rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
        return context.measures, [finding.problem for finding in context.broker.findings]

    return execute


ONE = ElectricalReading(5.0, 12.0)


@pytest.mark.parametrize(
    ("read", "channels"),
    [(lambda: ONE, ("",)), (lambda: (ONE, ONE), ("",)), (lambda: (ONE,), ("left", "right")), (lambda: None, ("",))],
)
def test_what_is_no_reading_for_each_channel_counts_as_failed_and_is_told(tmp_path, read, channels):
    clock, plugin = FakeClock(), ScriptedMeter(lambda _: None, channels=channels)
    plugin.read = read
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    measures = rehearse(context, plugin, mission=lambda: clock.sleep(2.0))
    assert set(measures.values()) == {None}
    said = (
        f"the meter returned {read()}, not an ElectricalReading for each channel"
        if read()
        else "the meter returned nothing"
    )
    assert any(said in finding.problem for finding in context.broker.findings)


def test_a_meter_that_cannot_be_closed_costs_no_run(tmp_path):
    def close():
        raise OSError("it is gone")

    clock, plugin = FakeClock(), ScriptedMeter(lambda time: ElectricalReading(5.0, wobbling(time)))
    plugin.close = close
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    assert rehearse(context, plugin, mission=lambda: clock.sleep(2.0))["MeanPower"] == 5.0
    (finding,) = context.broker.findings
    assert finding.problem == "the meter could not be closed: OSError: it is gone"


@pytest.mark.parametrize(("beside", "left_out"), [(-1e9, 1e9), (1.7e9, 1.7e9), (-4.0, 4.0), (3.0, 3.0), (0.0, None)])
def test_stamps_of_a_meter_by_another_clock_than_the_runs_are_told(measure, beside, left_out):
    def say(time):
        return ElectricalReading(5.0 + time % 0.3, wobbling(time), time=time + beside)

    problems = measure(say)[1]
    if left_out is None:
        assert problems == []
    else:
        (problem,) = [each for each in problems if "stamps" in each]
        assert "are they on the run's clock?" in problem
        assert float(problem.split(" s ")[0].rpartition(" ")[2]) == pytest.approx(left_out, abs=0.2, rel=1e-3)


def wobbling(time):
    return 12.0 + 0.001 * (round(time * 10) % 2)


def test_power_that_is_told_for_a_part_of_the_window_is_not_that_of_the_whole(measure):
    measures, problems = measure(lambda time: ElectricalReading(8.0 if time > 6.0 else None, wobbling(time)))
    assert (measures["Energy"], measures["MeanPower"]) == (None, None)
    assert measures["MeanVoltage"] == pytest.approx(12.0, abs=0.01)
    assert problems == ["the power was reported in 40 of 101 readings only"]


@pytest.mark.parametrize(("every", "is_doubted"), [(5.0, True), (5.07, True), (1.0, False), (0.2, False)])
def test_power_that_the_meter_seldom_renews_is_doubted(measure, every, is_doubted):
    def told(time):
        renewed = time // every * every  # what it said is as old as that
        return ElectricalReading(8.0 + 0.1 * (renewed * 7 % 3.1))

    values, problems = measure(told, seconds=50.0)
    assert values["Energy"] == pytest.approx(400.0, rel=0.05)
    message = f"the meter renews its power every {every:.1f} s only: the energy lacks what changed in between"
    assert [each for each in problems if "renews" in each] == ([message] if is_doubted else [])


@pytest.mark.parametrize(
    ("busy", "period", "told"),
    [
        (
            15.0,
            1.0,
            ["the power changed between samples that are 1.0 s apart: the energy may be off by 5.8 J of 115 J"],
        ),
        (15.0, 0.1, []),  # the same load
        (6.0, 1.0, []),
    ],
)
def test_an_energy_is_doubted_where_power_changed_much_between_samples_that_are_far_apart(tmp_path, busy, period, told):
    clock = FakeClock()  # 113 J, in truth
    plugin = ScriptedMeter(lambda time: ElectricalReading(busy if 0.7 < time < 8.7 else 5.0), rate_hz=1 / period)
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(8.0))
    assert [one.problem for one in context.broker.findings if "apart" in one.problem] == told


@pytest.mark.parametrize(
    ("rate_hz", "renewed", "is_doubted"), [(1.0, 0.0, True), (20.0, 1.0, True), (20.0, 0.0, False)]
)
def test_values_of_a_phase_are_doubted_where_power_changes_at_its_ends_and_is_rarely_renewed(
    tmp_path, rate_hz, renewed, is_doubted
):
    clock = FakeClock()

    def say(time):
        time = time // renewed * renewed if renewed else time
        return ElectricalReading((25.0 if 8.2 < time < 12.3 else 5.0) + 0.01 * (time * 0.7 % 1))  # with some noise

    plugin = ScriptedMeter(say, rate_hz=rate_hz)
    context = make_context(tmp_path, plugin, robot=None, clock=clock, phases=["lift"])

    def mission():
        clock.sleep(8.2)
        with context.phase("lift"):
            clock.sleep(4.1)
        clock.sleep(60.0)

    measures = rehearse(context, plugin, mission=mission)
    assert (abs(measures["Energy.lift"] / (25.0 * 4.1) - 1) > 0.05) == is_doubted
    doubted = [fields["measures"] for kind, fields in context.broker.records if kind == "finding"]
    assert doubted == ([["Energy.lift", "MeanPower.lift"]] if is_doubted else [])


@pytest.mark.parametrize(("renewed", "off"), [(2.0, "28 J of 410 J"), (1.0, "")])
def test_steps_between_updates_are_as_wide_as_those_however_often_the_meter_is_read(tmp_path, renewed, off):
    def say(time):
        told = time // renewed * renewed
        watts = (18.0, 18.0, 33.0, 21.0)[int(told // 3.3) % 4]
        return ElectricalReading(watts + 0.01 * (told * 0.37 % 1))

    clock, plugin = FakeClock(), ScriptedMeter(say, rate_hz=1.0)
    context = make_context(tmp_path, plugin, robot=None, clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(20.0))
    told = f"the power changed between samples that are 2.0 s apart: the energy may be off by {off}"
    assert [finding.problem for finding in context.broker.findings] == ([told] if off else [])


class CoarseCounter(ScriptedMeter):
    """Counts whole joules, 10 in a second; its power of a moment misses 4 % of that."""

    counter_step = 1.0

    def __init__(self):
        super().__init__(lambda time: ElectricalReading(9.6 + 0.01 * (time * 7 % 1), joules=10.0 * time // 1))


@pytest.mark.parametrize(
    ("seconds", "origin", "parts"),
    [(100.0, "counter", [40.0, 50.0, 10.0]), (100.0, "counter", [99.8, 0.2]), (12.0, "power", [9.0, 3.0])],
    ids=["fine", "too coarse for a part", "too coarse for all"],
)
def test_energies_of_phases_add_up_to_that_of_the_mission(tmp_path, seconds, origin, parts):
    clock, plugin = FakeClock(), CoarseCounter()
    names = [f"part{number}" for number in range(len(parts))]
    context = make_context(tmp_path, plugin, robot=None, clock=clock, phases=names)

    def mission():
        for name, duration in zip(names, parts, strict=True):
            with context.phase(name):
                clock.sleep(duration)

    measures = rehearse(context, plugin, mission=mission)
    facts = json.loads((context.raw_data_folder / "quality.json").read_text())
    assert facts["energy_from"] == {"": origin}
    assert measures["Energy"] == pytest.approx((10.0 if origin == "counter" else 9.6) * seconds, rel=0.01)
    assert math.fsum(measures[f"Energy.{name}"] for name in names) == pytest.approx(measures["Energy"], rel=0.001)
    assert measures[f"Energy.{names[-1]}"] == pytest.approx(9.8 * parts[-1], rel=0.03)


@pytest.mark.parametrize(("every", "is_doubted"), [(3.0, True), (2.0, True), (0.2, False)])
def test_an_energy_counter_that_is_seldom_renewed_is_doubted_where_there_is_no_power(measure, every, is_doubted):
    measures, problems = measure(
        lambda time: ElectricalReading(None, wobbling(time), joules=8.0 * (time // every * every)), seconds=11.5
    )
    assert (abs(measures["Energy"] / (8.0 * 11.5) - 1) > 0.04) == is_doubted
    assert ["may be behind by" in problem for problem in problems] == ([True] if is_doubted else [])


def test_an_energy_counter_that_is_seldom_renewed_gives_way_to_power(measure):
    measures, problems = measure(
        lambda time: ElectricalReading(8.0 + 0.01 * (time * 7 % 1), joules=8.0 * (time // 3 * 3)), seconds=11.5
    )
    assert measures["Energy"] == pytest.approx(8.0 * 11.5, rel=0.01)
    assert problems == []


def test_a_counter_that_is_told_for_a_part_of_the_window_does_not_stand_for_the_whole(measure):
    measures, problems = measure(
        lambda time: ElectricalReading(None, wobbling(time), joules=8.0 * time if time > 6.0 else None)
    )
    assert measures["Energy"] is None
    assert problems == ["the energy was reported in 40 of 101 readings only"]


def test_a_meter_that_falls_silent_shortly_before_the_end_measures_no_less(measure):
    def say(time):
        if time > 19.15:
            raise TimeoutError("silent")
        return ElectricalReading(8.0, wobbling(time))

    measures, problems = measure(say, seconds=20.0)
    assert (measures["Energy"], measures["MeanPower"]) == (pytest.approx(160.0), pytest.approx(8.0))
    assert any("readings failed" in problem for problem in problems)


def test_a_reading_without_power_now_and_then_is_bridged(measure):
    measures, problems = measure(
        lambda time: ElectricalReading(None if round(time * 10) % 3 == 0 else 8.0, wobbling(time))
    )
    assert measures["Energy"] == pytest.approx(80.0)
    assert not problems


@pytest.mark.parametrize(("rate", "told"), [(10.0, []), (2.5, ["the power was reported in 23 of 26 readings only"])])
def test_a_stretch_without_power_that_is_bridged_over_much_of_the_window_is_doubted(measure, rate, told):
    # The meter answers without its power, where another one would raise an error, and the quality would tell.
    missing = 3 / rate
    measures, problems = measure(
        lambda time: ElectricalReading(None if 3.05 < time < 3.05 + missing else 8.0, wobbling(time)), rate_hz=rate
    )
    assert measures["Energy"] == pytest.approx(80.0)
    assert problems == told


@pytest.mark.parametrize("odd", [float("nan"), float("inf"), 1e300])
def test_what_is_no_quantity_costs_a_reading_and_not_the_run(measure, odd):
    def say(time):
        return ElectricalReading(odd if 3.05 < time < 3.15 else 8.0, wobbling(time), joules=odd)

    measures, problems = measure(say)
    assert measures["Energy"] == pytest.approx(80.0)
    assert problems == ["the energy was reported in 0 of 101 readings only"]


def test_a_quantity_that_is_never_a_number_is_missing_for_a_reason(measure):
    values, problems = measure(lambda time: ElectricalReading(float("nan"), wobbling(time)))
    assert values["Energy"] is None
    assert problems == ["the power was reported in 0 of 101 readings only"]


@pytest.mark.parametrize("factor", [1e-3, 1e3], ids=["kW for W", "mW for W"])
@pytest.mark.parametrize(("since", "told"), [(0.0, "101 of 101"), (9.0, "11 of 101")])
def test_power_in_another_unit_than_voltage_and_current_is_doubted(measure, factor, since, told):
    def say(time):
        watts = 8.0 + 0.01 * (round(time * 10) % 7)
        return ElectricalReading(watts * (factor if time > since - 0.05 else 1.0), wobbling(time), watts / 12.0)

    problems = measure(say)[1]
    (problem,) = (each for each in problems if "contradicts" in each)
    assert problem.startswith(f"the power contradicts voltage times current in {told} readings, such as ")
    assert problem.endswith(" A: one of them may have another unit")


@pytest.mark.parametrize(
    ("watts", "volts", "amperes"),
    [
        (0.6, 230.0, 0.05),  # a charger that stands by: a power factor of 0.05
        (0.4, 230.0, 0.0),  # a current that is less than a step
        (4.5, 230.0, 0.01),  # a current of 0.0196 A, cut off
        (20.0, 12.0, None),  # a meter that tells no current
        (690.0, 230.0, 1.0),  # the power of three phases, and the current of one
        (0.0, 234.9, 0.08),  # a clamp without a load, as a Shelly Pro EM-50 told it
        (0.1, 234.9, 0.08),
        (0.2, 0.0, 5.0),  # a supply in constant current at 40 mV, told in steps of 0.1 V
        (0.0001, 0.0003, 0.00004),  # the noise of a supply that is switched off
        (0.0001, -0.0002, 0.00001),
    ],
)
def test_power_that_voltage_and_current_allow_is_not_doubted(measure, watts, volts, amperes):
    def say(time):
        wobble = 1 + 0.001 * (round(time * 10) % 7)
        return ElectricalReading(watts * wobble, volts * wobble, amperes)

    assert measure(say)[1] == []


@pytest.mark.parametrize(("volts", "amperes"), [(0.0, 0.7), (12.0, 0.0), (0.0, 0.0)])
def test_power_at_no_voltage_or_no_current_is_doubted(measure, volts, amperes):
    problems = measure(lambda time: ElectricalReading(8.0 + 0.01 * (round(time * 10) % 7), volts, amperes))[1]
    assert any("the power contradicts voltage times current" in each for each in problems)


def test_no_power_at_the_volts_and_amperes_of_a_load_is_doubted(measure):
    # As a Sonoff Pow R2 told it until it was started again (Tasmota's issue 3515).
    problems = measure(lambda time: ElectricalReading(0.0, 124.0 + wobbling(time) / 12.0, 0.521))[1]
    assert any("the power contradicts voltage times current in 101 of 101 readings" in each for each in problems)


@pytest.mark.parametrize("later", [0.02, 0.04])
def test_power_and_current_of_a_load_in_bursts_that_are_asked_one_after_the_other_are_no_contradiction(measure, later):
    def watts(time):
        return 300.0 if time % 0.407 < 0.2 else 8.0

    def say(time):
        return ElectricalReading(watts(time), wobbling(time), watts(time + later) / 12.0)

    problems = measure(say, seconds=60.0)[1]
    assert [each for each in problems if "contradicts" in each] == []


def test_power_in_another_unit_is_doubted_though_power_and_current_are_asked_one_after_the_other(measure):
    def watts(time):
        return 300.0 if time % 0.407 < 0.2 else 8.0

    def say(time):
        return ElectricalReading(watts(time) * (1e-3 if time > 30 else 1), wobbling(time), watts(time + 0.04) / 12.0)

    problems = measure(say, seconds=60.0)[1]
    assert [each for each in problems if "contradicts" in each] != []


@pytest.mark.parametrize("seconds", [10.0, 1.0])
def test_a_step_of_the_load_while_power_and_current_are_asked_is_no_contradiction(measure, seconds):
    def say(time):
        is_off, is_off_later = (time + later > seconds / 2 for later in (-0.05, 0.05))
        return ElectricalReading(0.4 if is_off else 40.0, wobbling(time), 0.034 if is_off_later else 3.4)

    assert [each for each in measure(say, seconds=seconds)[1] if "contradicts" in each] == []


def test_power_that_is_told_in_another_unit_in_every_other_reading_is_doubted(measure):
    def say(time):  # one that changes over to mW below 1 W
        is_idle = round(time * 10) % 2
        return ElectricalReading(500.0 if is_idle else 8.0, wobbling(time), (0.5 if is_idle else 8.0) / 12.0)

    assert any("contradicts voltage times current in 50 of 101 readings" in each for each in measure(say)[1])


@pytest.mark.parametrize(("share", "said"), [(1.0, []), (0.57, ["the energy counter rose by"])])
def test_bursts_that_readings_of_power_miss_do_not_contradict_a_counter_as_a_share_does(measure, share, said):
    chance = random.Random(4)  # noqa: S311 - reproducible, not secret
    watts = [chance.choice((8.0, 300.0)) for _ in range(500)]  # for a 30th of a second each
    joules = [0.0, *accumulate(share / 30 * each for each in watts)]

    def say(time):
        place = round(time * 30)
        return ElectricalReading(watts[place], wobbling(time), joules=joules[place])

    measures, problems = measure(say)
    assert measures["Energy"] == pytest.approx(joules[300])
    assert [each[:26] for each in problems] == said


@pytest.mark.parametrize(
    ("base", "said"),
    [
        (8.0, []),  # a motor that brakes now and then
        (
            -12.0,
            ["the energy is -140 J: the meter is the wrong way round, or the load feeds back"],
        ),  # a battery, charged
    ],
)
def test_a_counter_that_runs_backwards_while_the_load_feeds_back_was_not_set_back(measure, base, said):
    watts = [base - (20.0 if n % 100 in range(70, 80) else 0.0) for n in range(200)]
    joules = [500.0, *accumulate((0.1 * each for each in watts), initial=500.0)]

    def say(time):
        place = round(time * 10)
        return ElectricalReading(watts[place], wobbling(time), joules=joules[place + 1])

    measures, problems = measure(say)
    assert measures["Energy"] == pytest.approx(10 * base - 20.0, rel=0.02)
    assert problems == said


def test_a_counter_that_is_set_back_is_doubted_though_it_ran_backwards_before(measure):
    watts = [-4.0 if n in {30, 31} else 8.0 for n in range(200)]
    joules = list(accumulate((0.1 * each for each in watts), initial=0.0))

    def say(time):
        place = round(time * 10)
        return ElectricalReading(watts[place], wobbling(time), joules=joules[place] - (56.0 if place > 70 else 0.0))

    measures, problems = measure(say)
    assert measures["Energy"] == pytest.approx(77.6, rel=0.01)
    assert problems == ["the energy counter was set back"]


def test_a_load_of_two_states_that_is_switched_at_even_times_is_no_meter_that_is_seldom_renewed(measure):
    measures, problems = measure(  # a plug that tells whole watts, and a robot that goes to and fro
        lambda time: ElectricalReading(75.0 if time % 7.0 < 3.5 else 60.0, wobbling(time)), seconds=60.0
    )
    assert measures["Energy"] == pytest.approx(60 * 60.0 + 15 * 31.5, rel=0.01)
    assert problems == []


_RAILS = ("in", "gpu")


@pytest.mark.parametrize(
    ("amperes", "until", "said"),
    [
        (0.0, 10.0, []),  # an averaging sensor of coarse steps tells no noise of a rail that nothing draws from
        (0.4, 10.0, ["the meter reported the same value of gpu 101 times, for 10.0 s: it may be stuck"]),
        (
            0.0,
            5.0,
            [
                f"the meter reported the same value of {rail} 51 times, for 5.0 s: it may be stuck"
                for rail in ("in", "gpu")
            ],
        ),
    ],
)
def test_a_rail_that_nothing_is_drawn_from_is_not_stuck_while_others_of_its_meter_change(measure, amperes, until, said):
    def say(time):
        volts = wobbling(min(time, until))
        return (ElectricalReading(volts * 0.5, volts, 0.5), ElectricalReading(5.0 * amperes, 5.0, amperes))

    assert measure(say, channels=_RAILS)[1] == said
