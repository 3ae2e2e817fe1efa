"""What the link over rospy does beyond the contract, on a real master."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
import sys
import textwrap
import threading
import time
import xmlrpc.client
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path

import pytest
from tests.loopback_port import claim_port
from tests.ros.ros1_master import quiet_about_rospy, ros1_environment, ros1_master
from tests.waiting import wait_until

from robot_runner import node_present
from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import open_clock
from robot_runner.core.links.robot import Qos
from robot_runner.ros import ros1_node as node
from robot_runner.ros.graph_clock import GraphClock
from robot_runner.ros.link_opening import open_ros1_link
from robot_runner.ros.ros1_master import Master
from robot_runner.ros.ros1_publisher import Publisher
from robot_runner.ros.ros1_transport import _Subscription
from robot_runner.ros.ros1_types import as_mapping, as_message, message_class, shape_of
from robot_runner.ros.ros_graph import RosGraph
from robot_runner.ros.shapes import completed
from robot_runner.ros.transform_buffer import TransformBuffer
from robot_runner.testing import make_context, rehearse

STRING = "std_msgs/String"


@pytest.fixture
def opened(master_uri):
    with ExitStack() as closing:

        def open_link(namespace=""):
            link = open_ros1_link({"master": master_uri}, SystemClock(), namespace)
            closing.callback(link.close)
            return link

        yield open_link


@pytest.fixture
def own_nodes(master_uri):
    """The nodes that links are and that came during the test: a run that another test killed stays at the master."""

    def links():
        return {name for name in Master(master_uri).state().nodes if re.fullmatch(r"/robot_runner_\d+_\d+", name)}

    before = links()
    return lambda: links() - before


def set_parameter(uri, name, value):
    with xmlrpc.client.ServerProxy(uri) as server:
        server.setParam("/test", name, value)


@quiet_about_rospy
class TestMessages:
    def test_every_standard_message_goes_there_and_back(self):
        for name in (
            "nav_msgs/Odometry",
            "sensor_msgs/LaserScan",
            "sensor_msgs/BatteryState",
            "sensor_msgs/PointCloud2",
        ):
            cls = message_class(name)
            message = completed(shape_of(cls), {}, where=name)
            assert as_mapping(as_message(cls, message)) == message

    def test_a_header_keeps_its_sequence_number(self, opened):
        robot, link = opened(), opened()
        heard = []
        link.subscribe("odom", "nav_msgs/Odometry", heard.append)
        done = threading.Event()
        link.subscribe("odom", "nav_msgs/Odometry", lambda message: message["child_frame_id"] and done.set())
        for name in ("", "", "last"):
            robot.publish("odom", "nav_msgs/Odometry", {"child_frame_id": name}, qos=Qos.RELIABLE)
        assert done.wait(60.0)
        assert [message["header"]["seq"] for message in heard] == [1, 2, 3]

    def test_durations_may_be_negative(self):
        cls = message_class("std_msgs/Duration")
        message = completed(shape_of(cls), {"data": {"sec": -2, "nanosec": 500_000_000}}, where="test")
        assert as_mapping(as_message(cls, message)) == {"data": {"sec": -2, "nanosec": 500_000_000}}

    def test_a_type_that_is_generated_here_leaves_no_folder_no_path_and_nothing_for_the_end(self, tmp_path):
        # In a process of its own: a type is generated once, and what the process ends with is counted.
        generating = textwrap.dedent("""
            import atexit, os, sys, tempfile
            from pathlib import Path
            from robot_runner.ros.ros1_types import message_class, shape_of

            message_class("actionlib_tutorials/FibonacciGoal")  # whatever is imported for the first of them
            path, importers, at_end = [*sys.path], {*sys.path_importer_cache}, atexit._ncallbacks()
            made = message_class("actionlib_tutorials/FibonacciActionGoal")
            assert not any(made.__module__.startswith(each) for each in ("actionlib", "robot_runner")), made
            assert sys.path == path
            assert {*sys.path_importer_cache} == importers
            assert atexit._ncallbacks() == at_end
            assert not [*Path(tempfile.gettempdir()).iterdir()]
            assert shape_of(made).names == ("header", "goal_id", "goal")
            os._exit(0)  # as a run does
        """)
        environment = {**os.environ, "TMPDIR": str(tmp_path)}
        done = subprocess.run([sys.executable, "-c", generating], capture_output=True, env=environment, check=False)
        assert done.returncode == 0, done.stderr.decode()
        assert not [*tmp_path.iterdir()]

    @pytest.mark.parametrize(
        ("name", "fix"),
        [
            ("geometry_msgs/Twits", "'Twist'"),
            ("geometri_msgs/Twist", "install its package"),
            ("Twist", "geometry_msgs/"),
        ],
    )
    def test_an_unknown_type_is_named_with_the_nearest(self, name, fix):
        with pytest.raises(LinkError) as caught:
            message_class(name)
        assert fix in caught.value.fix


@quiet_about_rospy
class TestGraph:
    def test_the_next_message_of_a_publisher_that_is_there_reaches_a_new_subscription(self, opened):
        robot, link = opened(), opened()
        robot.advertise("answers", STRING)
        heard = threading.Event()
        link.subscribe("answers", STRING, lambda _: heard.set())
        robot.publish("answers", STRING, {"data": "the first"})
        assert heard.wait(60.0)

    def test_the_first_message_reaches_who_listens_already(self, opened):
        robot, link = opened(), opened()
        heard = threading.Event()
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda _: heard.set())
        link.publish("cmd_vel", "geometry_msgs/Twist", {})  # once, as a robot is stopped by a process that is new
        assert heard.wait(60.0)

    def test_a_robot_that_connects_before_its_publisher_is_complete_is_told_to_stand_still(self, opened, monkeypatch):
        publisher = import_module("rospy.topics")._PublisherImpl
        goes_on = publisher.add_subscriber_listener

        def go_on(impl, listener):  # rospy has told the master of the publisher by now, and sets the queue afterwards
            wait_until(impl.has_connections)
            goes_on(impl, listener)

        monkeypatch.setattr(publisher, "add_subscriber_listener", go_on)
        robot, link = opened(), opened()
        heard = []
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda message: heard.append(message["linear"]["x"]))
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        (connection,) = import_module("rospy").topics.get_topic_manager().get_publisher_impl("/cmd_vel").connections
        assert isinstance(connection, import_module("rospy.impl.tcpros_pubsub").QueuedConnection)
        link.close()
        wait_until(lambda: heard == [0.2, 0.0])

    def test_a_robot_to_which_the_config_publishes_without_a_queue_is_told_to_stand_still(self, opened):
        rospy, robot, link = import_module("rospy"), opened(), opened()
        heard = []
        robot.subscribe("cmd_vel", "geometry_msgs/Twist", lambda message: heard.append(message["linear"]["x"]))
        with pytest.warns(SyntaxWarning, match="queue_size"):
            own = rospy.Publisher("/cmd_vel", message_class("geometry_msgs/Twist"))
        wait_until(own.get_num_connections)
        link.publish("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}})
        link.close()
        own.unregister()
        wait_until(lambda: heard == [0.2, 0.0])

    def test_nothing_is_left_at_the_master(self, opened, own_nodes):
        link = opened()
        link.publish("lamp", STRING, {"data": "on"})
        link.subscribe("door", STRING, print)
        link.offer("bell", "std_srvs/Trigger", lambda _: {})
        assert own_nodes()
        link.close()
        assert own_nodes() == set()

    @pytest.mark.parametrize(
        ("waits", "use"),
        [
            ((Publisher, "reach"), lambda link: link.publish("chat", STRING, {"data": "hi"})),
            ((_Subscription, "connect"), lambda link: link.subscribe("chat", STRING, print)),
        ],
    )
    def test_nothing_is_left_at_the_master_of_a_topic_where_the_run_is_interrupted_as_it_is_joined(
        self, opened, own_nodes, monkeypatch, waits, use
    ):
        def interrupt(*_):
            raise RunInterrupted

        monkeypatch.setattr(*waits, interrupt)
        with pytest.raises(RunInterrupted):
            use(opened())
        assert own_nodes() == set()

    def test_one_node_is_all_robots_of_a_process(self, opened, own_nodes):
        alice, bob = opened("alice"), opened("bob")
        alice.publish("lamp", STRING, {})
        bob.publish("lamp", STRING, {})
        assert len(own_nodes()) == 1

    def test_a_service_that_a_dead_node_left_behind_can_be_offered_and_not_called(self, opened, master_uri):
        with xmlrpc.client.ServerProxy(master_uri) as server:
            nobody = f"http://127.0.0.1:{claim_port()}"
            server.registerService("/dead", "/left", f"rosrpc://127.0.0.1:{claim_port()}", nobody)
        robot, link = opened(), opened()
        with pytest.raises(LinkError, match="cannot be reached"):
            link.call("left", "std_srvs/Trigger", timeout=1.0)
        robot.offer("left", "std_srvs/Trigger", lambda _: {"success": True})
        assert link.call("left", "std_srvs/Trigger")["success"]

    def test_a_node_that_was_killed_is_neither_present_nor_counted(self, opened, master_uri, tmp_path):
        link = opened()
        link.publish("lamp", STRING, {"data": "on"})
        (own,) = {each.node for each in link.publishers("lamp")}
        graph = RosGraph(["/dead"])
        context = make_context(tmp_path, graph, robot=f"ros1:master={master_uri}", clock=SystemClock())
        nobody = f"http://127.0.0.1:{claim_port()}"
        with xmlrpc.client.ServerProxy(master_uri) as server, ExitStack() as watching:
            server.registerPublisher("/dead", "/left", STRING, nobody)
            watching.callback(server.unregisterPublisher, "/dead", "/left", nobody)
            watching.callback(context.resources.close)
            assert "/dead" in link.nodes()  # as `rosnode list` says
            assert node_present(own).watch(context, watching)().holds
            look = node_present("/dead").watch(context, watching)()
            assert (look.holds, look.is_known) == (False, True)
            assert look.seen == "/dead is listed by the graph and does not answer"
            measured = rehearse(context, graph)
        assert measured["CPU_dead"] is None
        assert "/dead" not in json.loads((context.run_path / "RosGraph" / "graph.json").read_text())["stop"]["nodes"]
        assert any("node /dead is not on the graph" in each.problem for each in context.broker.findings)

    def test_who_waits_in_vain_is_told_of_the_nearest_topic(self, opened):
        robot, link = opened(), opened()
        robot.publish("odometry", "nav_msgs/Odometry", {})
        with pytest.raises(LinkError) as caught:
            link.wait_for("odometri", "nav_msgs/Odometry", timeout=0.1)
        assert "did you mean '/odometry'?" in caught.value.fix

    @pytest.mark.long
    def test_a_publisher_of_another_type_that_comes_later_is_not_heard(self, opened, master_uri, caplog, tmp_path):
        link = opened()
        heard = []
        link.subscribe("later", STRING, heard.append)
        with caplog.at_level(logging.ERROR):
            execute(
                master_uri,
                """
                import rospy, std_msgs.msg
                rospy.init_node("other", disable_signals=True)
                publisher = rospy.Publisher("later", std_msgs.msg.Int32, queue_size=1, latch=True)
                publisher.publish(7)
                deadline = time.monotonic() + 60
                while not publisher.get_num_connections() and time.monotonic() < deadline:
                    time.sleep(0.01)
                time.sleep(0.2)
                rospy.signal_shutdown("done")
            """,
                folder=tmp_path,
            )
        assert heard == []
        assert "/other publishes std_msgs/Int32" in caplog.text

    @pytest.mark.long
    def test_transforms_are_heard_by_the_name_that_their_type_had_before_tf2(self, opened, master_uri, tmp_path):
        link, buffer = opened(), TransformBuffer()
        program = f"""
            import os, rospy, tf2_msgs.msg, geometry_msgs.msg
            class tfMessage(tf2_msgs.msg.TFMessage):  # as rosserial publishes it, and so the board of a TurtleBot3
                _type = "tf/tfMessage"
            told = geometry_msgs.msg.TransformStamped()
            told.header.frame_id, told.child_frame_id, told.transform.rotation.w = "odom", "base", 1.0
            rospy.init_node("board", disable_signals=True)
            rospy.Publisher("/tf", tfMessage, queue_size=1, latch=True).publish([told])
            deadline = time.monotonic() + 60
            while not os.path.exists({str(tmp_path / "heard")!r}) and time.monotonic() < deadline:
                time.sleep(0.01)
            rospy.signal_shutdown("done")
        """
        board = threading.Thread(target=execute, args=(master_uri, program), kwargs={"folder": tmp_path})
        board.start()
        with ExitStack() as closing:
            closing.callback(board.join)
            closing.callback((tmp_path / "heard").touch)
            deadline = time.monotonic() + 60
            while "/tf" not in link.topics():
                assert time.monotonic() < deadline
                time.sleep(0.01)
            assert link.topics()["/tf"] == "tf2_msgs/TFMessage"
            assert "geometry_msgs/TransformStamped[] transforms" in link.definition("tf/tfMessage")
            buffer.subscribe(link, closing)
            while not buffer.frames:
                assert time.monotonic() < deadline
                time.sleep(0.01)
        assert buffer.frames == ["base", "odom"]

    def test_a_master_that_hangs_holds_nobody_up(self):
        with pytest.raises(LinkError, match=r"took longer than 0\.1 s"):
            node.within(threading.Event().wait, where="/odom", doing="registering the subscriber", timeout=0.1)

    def test_a_process_is_on_one_graph_at_a_time(self, opened, tmp_path):
        first = opened()
        first.publish("lamp", STRING, {})
        with ros1_master(tmp_path) as uri:
            with pytest.raises(LinkError, match="is another") as caught:
                open_ros1_link({"master": uri}, SystemClock())
            assert "same master" in caught.value.fix
            first.close()
            second = open_ros1_link({"master": uri}, SystemClock())
            heard = threading.Event()
            second.subscribe("lamp", STRING, lambda _: heard.set())
            second.publish("lamp", STRING, {})
            assert heard.wait(60.0)
            assert "/lamp" in second.topics()
            second.close()
        again = opened()
        again.publish("lamp", STRING, {})
        assert "/lamp" in again.topics()


@quiet_about_rospy
class TestClock:
    def test_a_real_robot_lives_by_this_machine_s_clock(self, master_uri):
        resources = Resources()
        assert isinstance(open_clock(f"ros1:master={master_uri}", resources, 1), SystemClock)
        resources.close()

    def test_with_use_sim_time_the_run_lives_by_what_is_on_the_clock_topic(self, opened, master_uri):
        set_parameter(master_uri, "/use_sim_time", True)
        try:
            robot = opened()
            robot.publish("/clock", "rosgraph_msgs/Clock", {"clock": {"sec": 42}}, qos=Qos.TRANSIENT_LOCAL)
            resources = Resources()
            clock = open_clock(f"ros1:master={master_uri}", resources, 1)
            assert isinstance(clock, GraphClock)
            assert clock.now() == 42.0
            assert isinstance(open_clock(f"ros1:master={master_uri},clock=system", resources, 1), SystemClock)
            resources.close()
        finally:
            set_parameter(master_uri, "/use_sim_time", False)


def execute(uri, program, *, folder=None):
    """Execute a program in a process of its own and return what it printed."""
    environment = {
        "PATH": "/usr/bin:/bin",
        "HOME": "/nonexistent",
        **ros1_environment(uri, folder or Path("/nonexistent")),
    }
    done = subprocess.run(
        [sys.executable, "-c", "import time\n" + textwrap.dedent(program)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@quiet_about_rospy
class TestProcess:
    LINK = """
        import logging, os, signal, sys, threading
        before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
        handlers, kind = list(logging.getLogger().handlers), logging.getLoggerClass()
        from robot_runner.core.events.context import SystemClock
        from robot_runner.ros.link_opening import open_ros1_link
        link = open_ros1_link({}, SystemClock())
        link.publish("lamp", "std_msgs/String", {"data": "on"})
        link.subscribe("lamp", "std_msgs/String", lambda _: None)
        link.offer("bell", "std_srvs/Trigger", lambda _: {})
    """

    @pytest.mark.long
    def test_it_takes_no_signals_prints_nothing_and_writes_no_logs(self, master_uri, tmp_path):
        printed = execute(
            master_uri,
            self.LINK
            + """
        assert before == (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM))
        assert handlers == logging.getLogger().handlers and kind is logging.getLoggerClass()
        link.close()
        """,
            folder=tmp_path,
        )
        assert printed == ""
        assert list(tmp_path.iterdir()) == []

    def test_a_process_that_is_ended_hard_after_closing_leaves_nothing_behind(self, master_uri, own_nodes):
        execute(master_uri, self.LINK.rstrip() + "; link.close(); os._exit(0)\n")
        assert own_nodes() == set()

    def test_a_run_that_was_killed_is_taken_from_the_master_by_the_next_and_a_dead_node_of_another_s_is_not(
        self, master_uri, opened, own_nodes
    ):
        execute(master_uri, self.LINK.rstrip() + "; os._exit(0)\n")
        (gone,) = own_nodes()
        with xmlrpc.client.ServerProxy(master_uri) as server:
            nowhere = f"http://127.0.0.1:{claim_port()}"
            server.registerPublisher("/move_base", "/lamp", "std_msgs/String", nowhere)
        assert [each.node for each in opened().publishers("lamp")] == []
        state = Master(master_uri).state()
        with xmlrpc.client.ServerProxy(master_uri) as server:
            server.unregisterPublisher("/move_base", "/lamp", nowhere)
        assert gone not in state.nodes
        assert "/move_base" in state.publishers["/lamp"]

    def test_where_a_run_that_was_killed_is_the_only_one_it_is_taken_away_and_the_node_of_another_is_not(
        self, master_uri, opened, own_nodes
    ):
        execute(master_uri, self.LINK.rstrip() + "; os._exit(0)\n")
        (gone,) = own_nodes()
        assert [each.node for each in opened().publishers("lamp")] == []  # a robot was said to be out of reach for it
        assert gone not in Master(master_uri).state().nodes
        told = {}
        # The second is of ours, on another machine that refuses us: it may well command the robot.
        for name, host in (("/move_base", "127.0.0.1"), ("/robot_runner_1_1769853600000", "127.0.0.2")):
            nowhere = f"http://{host}:{claim_port()}"
            with xmlrpc.client.ServerProxy(master_uri) as server:
                server.registerPublisher(name, "/lamp", "std_msgs/String", nowhere)
                told[name] = [each.node for each in opened().publishers("lamp")]
                server.unregisterPublisher(name, "/lamp", nowhere)
        assert told == {name: [name] for name in told}

    def test_a_run_that_was_killed_is_taken_from_the_master_where_another_process_has_its_address(
        self, master_uri, opened
    ):
        gone = "/robot_runner_1_1769853600000"
        with xmlrpc.client.ServerProxy(master_uri) as server:  # the master itself answers there, as a node would
            server.registerPublisher(gone, "/lamp", "std_msgs/String", master_uri)
            server.registerPublisher("/move_base", "/lamp", "std_msgs/String", master_uri)
        assert [each.node for each in opened().publishers("lamp")] == ["/move_base"]
        with xmlrpc.client.ServerProxy(master_uri) as server:
            server.unregisterPublisher("/move_base", "/lamp", master_uri)
        assert gone not in Master(master_uri).state().nodes

    def test_a_run_of_another_machine_that_refuses_us_stays_at_the_master(self, master_uri, opened):
        other, nowhere = "/robot_runner_1_1769853600000", f"http://127.0.0.2:{claim_port()}"
        with xmlrpc.client.ServerProxy(master_uri) as server:  # as behind a firewall that lets the robot through alone
            server.registerPublisher(other, "/lamp", "std_msgs/String", nowhere)
            server.registerPublisher("/move_base", "/lamp", "std_msgs/String", master_uri)
        assert [each.node for each in opened().publishers("lamp")] == ["/move_base"]
        kept = Master(master_uri).state().publishers["/lamp"]
        with xmlrpc.client.ServerProxy(master_uri) as server:
            server.unregisterPublisher(other, "/lamp", nowhere)
            server.unregisterPublisher("/move_base", "/lamp", master_uri)
        assert other in kept

    @pytest.mark.long
    def test_a_run_s_process_cannot_use_the_orchestrator_s_node(self, master_uri):
        printed = execute(
            master_uri,
            self.LINK
            + """
        if os.fork() == 0:
            try:
                open_ros1_link({}, SystemClock())
            except Exception as error:
                print(error)
            sys.stdout.flush()
            os._exit(0)
        os.wait()
        link.close()
        """,
        )
        assert "the orchestrating process is a ROS node already" in printed
        assert "from start_run on" in printed
