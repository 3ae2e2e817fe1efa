from __future__ import annotations

import csv
import re

import pytest

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.events.early_end import RunFailed
from robot_runner.core.events.measure import Origin
from robot_runner.core.links.robot import GraphEndpoint
from robot_runner.plugins import Circumstances
from robot_runner.plugins.systems import BasicTurtlebot3
from robot_runner.testing import FakeClock, FakeLinks, FakeTurtlebot3Link, SystemContract, make_context, rehearse

SHORT = {"sleep_s": 0.5, "drive_s": 2.0, "task_s": 1.0, "rotate_s": 4.0}
SHORT_SECONDS = 6 * 0.5 + 2 * 2.0 + 3 * 1.0 + 4.0


class TestBasicTurtlebot3OnTheSimulatedRobot(SystemContract):
    combination = {"Task": "Video"}  # noqa: RUF012 - as an author of a plugin writes it

    def make_plugin(self) -> BasicTurtlebot3:
        return BasicTurtlebot3(sleep_s=0.2, drive_s=1.0, task_s=0.3, rotate_s=3.0)


class TestBasicTurtlebot3OnAnIdealRobot(SystemContract):
    breaking_points = 40
    combination = {"Task": "Network"}  # noqa: RUF012 - as an author of a plugin writes it

    def make_plugin(self) -> BasicTurtlebot3:
        return BasicTurtlebot3(**SHORT)

    def make_links(self, clock: FakeClock) -> FakeLinks:
        return FakeLinks(robot=FakeTurtlebot3Link(clock))


class Stage:
    """An ideal robot and a short mission for it."""

    def __init__(self, folder, *, slip=0.0, is_simulated=False, task="Video", **parameters):
        self.clock = FakeClock(1000.0)
        self.robot = FakeTurtlebot3Link(self.clock, slip=slip, is_simulated=is_simulated)
        self.plugin = BasicTurtlebot3(**(SHORT | parameters))
        self.context = make_context(
            folder,
            self.plugin,
            links=FakeLinks(robot=self.robot),
            clock=self.clock,
            combination={"Task": task},
        )

    def execute(self):
        return rehearse(self.context, self.plugin)

    @property
    def phases(self) -> list[dict[str, str]]:
        with (self.context.raw_data_folder / "phases.csv").open(newline="") as file:
            return list(csv.DictReader(file))


@pytest.fixture
def stage(tmp_path):
    def build(**parameters) -> Stage:
        return Stage(tmp_path, **parameters)

    return build


def commands(robot) -> list[tuple[float, float, float]]:
    return [
        (each.time, each.message["linear"]["x"], each.message["angular"]["z"])
        for each in robot.publications
        if each.topic == "cmd_vel"
    ]


def test_the_mission_is_circular_and_takes_the_planned_time(stage):
    measures = stage().execute()
    assert measures["Duration"] == pytest.approx(SHORT_SECONDS, abs=0.01)
    assert measures["PoseError"] < 0.01
    assert measures["Distance"] == pytest.approx(2 * 0.2 * 1.3, rel=0.05)


def test_the_robot_turns_by_half_a_circle(stage):
    played = stage()
    played.execute()
    assert abs(played.robot.heading) == pytest.approx(3.14159, abs=0.01)


def test_wheels_that_slip_evenly_are_mended_by_the_odometry(stage):
    measures = stage(slip=0.08, drive_s=6.0, rotate_s=8.0).execute()
    assert measures["PoseError"] < 0.02


def test_no_command_is_beyond_what_the_robot_can_do(stage):
    played = stage(slip=0.3)
    played.execute()
    assert max(abs(speed) for _, speed, _ in commands(played.robot)) <= 0.22


def test_its_phases_are_those_of_the_run(stage):
    played = stage()
    played.execute()
    assert [phase.name for phase in played.context.phases] == [row["phase"] for row in played.phases]
    for phase, row in zip(played.context.phases, played.phases, strict=True):
        assert phase.window.start == pytest.approx(float(row["start_s"]), abs=1e-4)
        assert phase.window.end == pytest.approx(float(row["end_s"]), abs=1e-4)


def test_phases_are_kept_with_their_times_and_poses(stage):
    played = stage()
    played.execute()
    kinds = [row["phase"] for row in played.phases]
    assert kinds == [phase.kind.value for phase in played.plugin.mission.phases]
    assert [row["task"] for row in played.phases if row["phase"] == "task"] == ["video"] * 3
    starts, ends = ([float(row[edge]) for row in played.phases] for edge in ("start_s", "end_s"))
    assert ends[:-1] == pytest.approx(starts[1:], abs=1e-3)
    assert ends[-1] - starts[0] == pytest.approx(SHORT_SECONDS, abs=0.01)
    assert float(played.phases[1]["x_m"]) == pytest.approx(0.26, abs=0.01)


def test_phases_are_told_as_they_begin(stage):
    played = stage()
    played.execute()
    told = [fields["values"] for kind, fields in played.context.broker.records if kind == "shared"]
    assert told[0] == {"phase": "sleep", "phase_number": 1, "phase_count": 12}
    assert [values["phase_number"] for values in told] == list(range(1, 13))


@pytest.mark.parametrize("task", ["Computation", "video", "NETWORK"])
def test_the_treatment_decides_which_services_are_called(stage, task):
    played = stage(task=task)
    played.execute()
    name = task.casefold()
    called = [call.service for call in played.robot.calls if call.service != "task/stop"]
    assert called == [f"task/{name}/start", f"task/{name}/stop"] * 3


def test_the_task_may_be_the_same_for_all_runs(stage):
    played = stage(task_factor=None, task="Computation")
    played.plugin.task = "Network"
    played.execute()
    assert [call.service for call in played.robot.calls][:2] == ["task/stop", "task/network/start"]


def test_a_task_that_an_earlier_run_left_running_is_ended_before_anything_is_measured(stage):
    played = stage()
    left = {"success": True, "message": "network stopped: 12 chunks sent"}
    played.robot._services["task/stop"] = left
    played.plugin.start_run(played.context)
    assert [call.service for call in played.robot.calls] == ["task/stop"]
    warned = [finding.problem for finding in played.context.broker.findings]
    assert warned[:1] == ["a task was still running on the robot: network stopped: 12 chunks sent"]


def test_the_robot_works_only_in_the_task_phases(stage):
    played = stage()
    working = []
    played.clock.every(0.1, lambda: working.append((played.clock.now(), played.robot.working_on)))
    played.execute()
    spans = [(float(row["start_s"]), float(row["end_s"])) for row in played.phases if row["phase"] == "task"]
    for time, task in working:
        if not any(abs(time - edge) < 0.01 for span in spans for edge in span):
            assert (task is not None) == any(start < time < end for start, end in spans)


def test_odometry_that_stops_while_driving_breaks_the_mission_off_and_stops_the_robot(stage):
    played = stage(drive_s=6.0)
    played.robot.odometry_ends_at = 1000.0 + 2.0
    with pytest.raises(LinkError, match=r"no odometry arrived for 1\.\d s") as raised:
        played.execute()
    assert played.clock.now() < 1000.0 + 2.0 + 1.2
    assert played.robot.stands_still
    assert "odom" in raised.value.fix


def test_odometry_that_stops_while_a_task_goes_on_stops_the_task(stage):
    played = stage(task_s=30.0)
    played.clock.at(1000.0 + 5.0, lambda: setattr(played.robot, "odometry_ends_at", 0.0))
    with pytest.raises(LinkError, match="no odometry"):
        played.execute()
    assert played.clock.now() < 1000.0 + 5.0 + 1.6
    assert played.robot.working_on is None


def test_the_mission_stops_the_robot_itself_and_does_not_leave_it_to_the_closing_events(stage):
    played = stage(task_s=10.0)
    played.plugin.start_run(played.context)
    played.robot.odometry_ends_at = 1000.0 + 3.5
    played.context.times.begin()
    with pytest.raises(LinkError):
        played.plugin.launch_mission(played.context)
    assert played.robot.working_on is None
    assert played.robot.calls[-1].service == "task/stop"


def test_the_end_of_the_run_stops_a_robot_that_the_config_set_in_motion(stage):
    played = stage()
    played.plugin.start_run(played.context)
    played.robot.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
    assert played.robot.topics_heard == {"odom", "/cmd_vel"}
    played.plugin.stop_run(played.context)
    assert played.robot.stands_still
    assert played.robot.topics_heard == set()


def test_a_second_run_whose_robot_cannot_be_reached_does_not_close_the_robot_of_the_first(stage, tmp_path):
    played = stage()
    played.execute()
    played.context.resources.close()
    lost = FakeTurtlebot3Link(played.clock)
    lost.fault = LinkError("no route to the robot")
    second = make_context(tmp_path / "second", played.plugin, links=FakeLinks(robot=lost), clock=played.clock)
    with pytest.raises(LinkError, match="no route"):
        played.plugin.start_run(second)
    played.plugin.stop_run(second)


def test_phases_before_a_failure_are_on_disk(stage):
    played = stage()
    played.robot.odometry_ends_at = 1000.0 + 2.6
    with pytest.raises(LinkError):
        played.execute()
    assert [row["phase"] for row in played.phases] == ["sleep", "forward", "sleep"]


def test_a_robot_that_does_not_answer_is_found_out_before_the_mission(stage):
    played = stage(connect_timeout_s=3.0)
    played.robot.odometry_ends_at = 0.0
    with pytest.raises(LinkError, match=r"no odometry arrived for 3\.0 s"):
        played.execute()
    assert not any(speed for _, speed, _ in commands(played.robot))


def test_a_task_that_the_robot_refuses_fails_the_run_with_its_reason(stage):
    played = stage()
    played.robot._services["task/video/start"] = {"success": False, "message": "no camera"}
    with pytest.raises(LinkError, match="no camera"):
        played.execute()
    assert played.robot.stands_still


def test_wheels_are_stopped_although_the_tasks_cannot_be(stage):
    played = stage()
    played.clock.at(1000.0 + 1.5, played.robot._services.clear)
    with pytest.raises(LinkError):
        played.execute()
    assert played.robot.stands_still


def test_make_safe_stops_a_robot_that_another_process_set_in_motion(stage):
    played = stage()
    played.robot.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
    played.plugin.make_safe(played.context)
    assert played.robot.stands_still
    assert played.robot.calls[-1].service == "task/stop"


def test_make_safe_stops_the_tasks_of_a_robot_whose_wheels_cannot_be_reached(stage, monkeypatch):
    played = stage()

    def publish(topic, *_):
        raise LinkError("somebody subscribes it as another type", where=topic)

    monkeypatch.setattr(played.robot, "publish", publish)
    with pytest.raises(LinkError, match="as another type"):
        played.plugin.make_safe(played.context)
    assert "task/stop" in [each.service for each in played.robot.calls]


def test_a_robot_that_does_not_move_fails_its_run(stage):
    with pytest.raises(LinkError, match=r"covered 0\.000 m of 0\.52 m"):
        stage(slip=1.0).execute()


def test_a_robot_that_is_blocked_on_a_long_way_fails_its_run_before_the_way_is_over(stage):
    played = stage(slip=1.0, drive_s=20.0)
    with pytest.raises(LinkError, match="does not move as it is commanded"):
        played.execute()
    assert played.clock.now() < 1000.0 + 0.5 + 8.0
    assert played.robot.stands_still


@pytest.mark.parametrize("slip", [0.5, 0.3, -1.0], ids=["half of it", "less than nine tenths", "more than it"])
def test_a_robot_that_covered_another_way_than_planned_is_told(stage, slip):
    played = stage(slip=slip)
    measures = played.execute()
    problem = f"covered {measures['Distance']:.2f} m of 0.52 m"
    assert any(problem in finding.problem for finding in played.context.broker.findings)


def test_odometry_that_jumps_fails_the_run(stage):
    played = stage(drive_s=6.0)
    played.clock.at(1000.0 + 3.0, lambda: setattr(played.robot, "x", 1000.0))
    with pytest.raises(LinkError, match=r"odometry jumped by 999\.\d+ m within 0\.0\d s"):
        played.execute()
    assert played.robot.stands_still


@pytest.mark.parametrize("is_stamped", [True, False], ids=["with stamps", "without"])
def test_messages_of_the_odometry_that_are_lost_are_no_jump(stage, monkeypatch, is_stamped):
    if not is_stamped:
        monkeypatch.setattr("robot_runner.ros.turtlebot3.odometry.nanoseconds_of", lambda _: 0)
    played = stage(drive_s=6.0, odometry_timeout_s=3.0)
    played.clock.at(1000.0 + 2.0, lambda: setattr(played.robot, "odometry_ends_at", 0.0))
    played.clock.at(1000.0 + 4.0, lambda: setattr(played.robot, "odometry_ends_at", 2000.0))
    assert played.execute()["Distance"] > 0


def test_a_robot_that_moves_while_it_is_to_stand_still_fails_its_run(stage):
    played = stage(task_s=20.0)
    played.clock.at(1000.0 + 8.0, lambda: setattr(played.robot, "_speed", 0.2))
    with pytest.raises(LinkError, match=r"moved by 0\.\d+ m while it was to stand still"):
        played.execute()
    assert played.robot.stands_still


TELEOP = GraphEndpoint("/teleop", "geometry_msgs/Twist")
ROBOT = GraphEndpoint("/turtlebot3_node", "nav_msgs/Odometry")


def test_a_second_publisher_of_the_odometry_is_refused_before_the_robot_moves(stage):
    played = stage()
    played.robot.known_publishers["/odom"] = [ROBOT, GraphEndpoint("/ekf", "nav_msgs/Odometry")]
    with pytest.raises(LinkError, match="/ekf and /turtlebot3_node publish '/odom'"):
        played.execute()
    assert not any(speed for _, speed, _ in commands(played.robot))


def test_where_the_user_allows_it_others_make_the_run_doubtful(stage):
    played = stage(sole_control=False)
    played.robot.known_publishers["/odom"] = [ROBOT, GraphEndpoint("/ekf", "nav_msgs/Odometry")]
    played.execute()
    assert any("/ekf and /turtlebot3_node" in finding.problem for finding in played.context.broker.findings)


def test_a_robot_that_subscribes_no_velocity_commands_is_refused_before_the_mission(stage):
    played = stage()
    played.robot.known_subscribers["/cmd_vel"] = [GraphEndpoint("/drone", "mavros_msgs/Thrust")]
    with pytest.raises(LinkError, match="/drone subscribes '/cmd_vel' as mavros_msgs/Thrust") as raised:
        played.execute()
    assert "geometry_msgs/Twist or geometry_msgs/TwistStamped" in raised.value.fix


def test_whoever_could_command_the_robot_as_well_is_warned_of_but_for_our_watchdog(stage):
    played = stage()
    watchdog = GraphEndpoint("/robot_runner_watchdog", "geometry_msgs/Twist")
    played.robot.known_publishers["/cmd_vel"] = [TELEOP, watchdog]
    played.execute()
    told = [finding.problem for finding in played.context.broker.findings]
    assert told == ["/teleop could command the robot, too, on '/cmd_vel'"]


@pytest.mark.parametrize(
    ("nodes", "odometry", "told"),
    [
        (["/base", "/bob/base"], [], "/base and /bob/base"),
        (["/base", "/bob/wheels"], ["/base", "/bob/wheels"], "/base and /bob/wheels"),
        (["/base", "/record_17", "/safety"], ["/base"], None),
        (["/base", "/filter"], ["/base", "/filter"], None),
        (["/base", "/front/guard", "/rear/guard"], ["/base"], None),
    ],
    ids=["of one name", "with odometry", "one robot", "a filter of the odometry", "helpers of one name"],
)
def test_robots_that_share_the_topic_of_commands_by_mistake_are_warned_of(stage, nodes, odometry, told):
    """Both drove, and nothing was said, as the odometry of the other one has its namespace."""
    played = stage()
    played.robot.known_subscribers["/cmd_vel"] = [GraphEndpoint(each, "geometry_msgs/Twist") for each in nodes]
    played.robot.known_topics["/bob/odom"] = "nav_msgs/Odometry"
    played.robot.known_publishers["/bob/odom"] = [GraphEndpoint(each, "nav_msgs/Odometry") for each in odometry]
    played.robot.known_subscribers["/bob/odom"] = [GraphEndpoint("/filter", "nav_msgs/Odometry")]
    played.execute()
    said = f"{told} subscribe '/cmd_vel' as two robots would, and all of them would move"
    assert [finding.problem for finding in played.context.broker.findings] == ([said] if told else [])


def test_a_command_of_somebody_else_fails_the_run_and_names_who_it_was(stage):
    played = stage()
    played.robot.known_publishers["/cmd_vel"] = [TELEOP]
    back = {"linear": {"x": -0.1}, "angular": {"z": 0.0}}
    played.clock.at(1000.0 + 1.0, lambda: played.robot.deliver("/cmd_vel", back))
    with pytest.raises(RunFailed, match=r"/teleop commands the robot on '/cmd_vel': -0\.1 m/s, 0 rad/s"):
        played.execute()
    assert played.robot.stands_still


def test_task_services_that_are_missing_are_told_before_the_robot_moves(stage):
    played = stage()
    del played.robot._services["task/video/stop"]
    with pytest.raises(LinkError, match="there is no service '/task/video/stop'"):
        played.execute()
    assert not any(speed for _, speed, _ in commands(played.robot))


def test_a_mission_that_ended_elsewhere_is_told(stage):
    played = stage(slip=0.6, drive_s=6.0)
    assert played.execute()["PoseError"] > 0.1
    assert any("from where it began" in finding.problem for finding in played.context.broker.findings)


def test_a_mission_that_did_not_take_place_has_no_measures(stage):
    played = stage()
    played.plugin.populate_run_data(played.context)
    assert set(played.context.measures.values()) == {None}
    assert played.context.broker.findings[0].problem == "the mission was not executed to its end"


def test_a_mission_cannot_be_launched_before_the_run_starts(stage):
    played = stage()
    with pytest.raises(PluginError, match="before the run was started"):
        played.plugin.launch_mission(played.context)


def test_a_treatment_of_a_hand_written_run_table_that_is_no_task_fails_the_run(stage):
    with pytest.raises(PluginError, match="'Vidoe' is not a task") as raised:
        stage(task="Vidoe").execute()
    assert raised.value.fix == "Did you mean 'Video'?"


@pytest.mark.parametrize(("is_simulated", "origin"), [(True, Origin.SIMULATED), (False, Origin.MEASURED)])
def test_measures_of_a_mission_say_where_they_come_from(stage, is_simulated, origin):
    played = stage(is_simulated=is_simulated)
    played.execute()
    assert {published.origin for published in played.context.broker.measures.values()} == {origin}


@pytest.mark.parametrize(
    ("parameters", "factors", "problem", "fix"),
    [
        ({}, {"Task": ["Computation", "Vidoe"]}, "'Vidoe' is not a task", "Did you mean 'Video'?"),
        ({}, {"Task": ["Computation", None]}, "None is not a task", "Choose one of"),
        ({}, {"Speed": [0.1]}, "no factor 'Task'", "task='Computation'"),
        ({"task_factor": None}, {}, "no task is given", "task='Computation'"),
        ({"task": "Netwrok"}, {}, "'Netwrok' is not a task", "Did you mean 'Network'?"),
        ({"task": "Video"}, {"Task": ["Video"]}, "the factor 'Task' varies the task", "Leave out task"),
    ],
)
def test_its_check_finds_what_is_wrong_with_the_task(parameters, factors, problem, fix):
    findings = list(BasicTurtlebot3(**parameters).check(Circumstances(robot="simulated", factors=factors)))
    assert len(findings) == 1
    assert problem in findings[0].problem
    assert fix in findings[0].fix


@pytest.mark.parametrize(
    ("parameters", "factors"),
    [
        ({}, {"Task": ["computation", "VIDEO", "Network"]}),
        ({"task_factor": "Load"}, {"Load": ["Video"]}),
        ({"task_factor": None, "task": "Video"}, {"Task": ["my own", "meaning"]}),
        ({"task": "Video"}, {}),
    ],
)
def test_its_check_is_content_with_tasks_that_are_known(parameters, factors):
    assert list(BasicTurtlebot3(**parameters).check(Circumstances(robot="simulated", factors=factors))) == []


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"robot": "'simulated'", "repetitions": 0}, ["repetitions"]),
        ({"robot": "'simulated',", "repetitions": 1}, ["robot"]),
    ],
)
def test_an_error_elsewhere_in_the_config_is_not_told_as_one_of_the_turtlebot3(write_config, settings, told):
    """The factor `Task`, or the robot, stood there, and a check said that there was none."""
    head = """
from robot_runner import *
from robot_runner.plugins.profilers import Ina219
from robot_runner.plugins.systems import BasicTurtlebot3
class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    plugins = [BasicTurtlebot3(), Ina219()]
    robot = {robot}
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])], repetitions={repetitions})
"""
    findings = prepare(write_config(head=head.format(**settings), table="")).findings
    assert [re.split(r"\W+", finding.where)[-1] for finding in findings] == told


def test_its_check_says_how_to_name_a_robot():
    findings = list(BasicTurtlebot3().check(Circumstances(factors={"Task": ["Video"]})))
    assert [finding.is_error for finding in findings] == [True]
    assert "--set robot=simulated" in findings[0].fix


def test_the_simulated_mission_ends_within_a_centimetre_of_its_beginning(tmp_path):
    plugin = BasicTurtlebot3(sleep_s=0.2, task_s=0.2, rotate_s=8.0)
    context = make_context(tmp_path, plugin, combination={"Task": "Video"})
    measures = rehearse(context, plugin)
    context.resources.close()
    assert measures["PoseError"] < 0.01
    assert measures["Distance"] == pytest.approx(3.4, rel=0.03)


def test_two_robots_with_one_namespace_are_refused():
    alice, again = BasicTurtlebot3(name="alice", namespace="/a"), BasicTurtlebot3(name="again", namespace="a")
    circumstances = Circumstances(robot="simulated", factors={"Task": ["Video"]}, plugins=[alice, again])
    assert list(alice.check(circumstances)) == []
    (finding,) = again.check(circumstances)
    assert "'/a'" in finding.problem
    assert "'alice'" in finding.problem
    assert "namespace=" in finding.fix
    bob = BasicTurtlebot3(name="bob", namespace="b")
    assert list(bob.check(Circumstances(robot="simulated", factors={"Task": ["Video"]}, plugins=[alice, bob]))) == []


def test_a_robot_that_hears_no_commands_is_found_before_the_mission(stage):
    played = stage()
    played.robot.known_topics = {"cmd_vell": "geometry_msgs/Twist"}
    with pytest.raises(LinkError, match="no topic '/cmd_vel'") as caught:
        played.plugin.start_run(played.context)
    assert "'/cmd_vell'" in caught.value.fix


def test_a_topic_of_commands_that_others_publish_and_the_robot_does_not_subscribe_is_found_before_the_mission(stage):
    played = stage()
    played.robot.known_subscribers["/cmd_vel"] = []
    with pytest.raises(LinkError, match="no node subscribes '/cmd_vel'") as caught:
        played.plugin.start_run(played.context)
    assert "bringup" in caught.value.fix


def test_a_robot_that_is_discovered_after_others_on_its_topic_hears_commands_of_its_type(stage):
    played, stamped = stage(), "geometry_msgs/TwistStamped"
    played.robot.known_topics["cmd_vel"] = stamped  # a joystick's node publishes it
    played.robot.known_subscribers["/cmd_vel"] = []
    base = [GraphEndpoint("/base", stamped)]
    played.clock.at(played.clock.now() + 1.0, lambda: played.robot.known_subscribers.update({"/cmd_vel": base}))
    played.execute()
    assert {each.message_type for each in played.robot.publications if each.topic == "cmd_vel"} == {stamped}
    assert {each for topic, each in played.robot._advertised.items() if topic == "cmd_vel"} == {stamped}


def test_two_robots_on_one_topic_are_told_by_their_stamps(stage):
    played = stage()
    played.plugin.start_run(played.context)
    position = {"position": {"x": 0.0, "y": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    for second in (7, 5) * 7:
        stamp = {"stamp": {"sec": second, "nanosec": 0}}
        played.robot.deliver("odom", {"header": stamp, "pose": {"pose": position}})
    with pytest.raises(LinkError, match="went back 8 times") as caught:
        played.plugin.launch_mission(played.context)
    assert "namespace of its own" in caught.value.fix


def test_a_simulated_robot_on_a_graph_is_labelled_as_such(stage):
    played = stage()
    played.robot.known_topics["/clock"] = "rosgraph_msgs/Clock"
    played.execute()
    assert {each.origin for each in played.context.broker.measures.values()} == {Origin.SIMULATED}


def test_a_simulated_robot_is_labelled_as_such_on_a_graph_that_is_known_only_while_it_drives(stage):
    played = stage()
    clock = played.clock
    clock.at(clock.now() + 7.0, lambda: played.robot.known_topics.update({"/clock": "rosgraph_msgs/Clock"}))
    played.execute()
    assert {each.origin for each in played.context.broker.measures.values()} == {Origin.SIMULATED}


def test_what_broke_the_mission_off_is_told_though_the_robot_cannot_be_made_safe(stage):
    played = stage()
    played.plugin.start_run(played.context)
    played.robot.odometry_ends_at = played.clock.now() + 1.0

    def lose_the_link():
        played.robot.fault = LinkError("the cable came off", where="robot", fix="Plug it in.")

    played.clock.at(played.clock.now() + 1.5, lose_the_link)
    played.robot.publish = lambda *_, **__: None  # commands go nowhere, and nobody says so
    played.context.times.begin()
    with pytest.raises(LinkError, match="no odometry arrived") as caught:
        played.plugin.launch_mission(played.context)
    assert "could not be made safe" in caught.value.__notes__[0]
    assert "the cable came off" in caught.value.__notes__[0]


def test_a_robot_that_hears_stamped_commands_drives_the_same_mission(stage):
    played = stage()
    played.robot.known_topics["cmd_vel"] = "geometry_msgs/TwistStamped"
    measures = played.execute()
    assert measures["Distance"] == pytest.approx(2 * 0.2 * 1.3, rel=0.05)
    assert {each.message_type for each in played.robot.publications if each.topic == "cmd_vel"} == {
        "geometry_msgs/TwistStamped"
    }
    assert played.robot.stands_still
