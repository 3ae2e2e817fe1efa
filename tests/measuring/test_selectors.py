from __future__ import annotations

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.measuring.host import checked_words, process_selector
from robot_runner.measuring.local_host import matches
from robot_runner.measuring.on_board.loop import names_of


@pytest.mark.parametrize(
    ("process", "selector"),
    [
        (4711, "pid:4711"),
        ("pid:4711", "pid:4711"),
        ("move_base", "name:move_base"),
        ("name:a:b", "name:a:b"),
        ("node:/talker", "node:/talker"),
    ],
)
def test_a_process_is_selected_by_number_name_or_node(process, selector):
    assert process_selector(process) == selector


@pytest.mark.parametrize("process", ["", "  ", "pid:x", "node:", True, 1.5, None, -5, 0, "nod:/talker"])
def test_what_selects_no_process_is_refused(process):
    with pytest.raises(LinkError, match="selects no process"):
        process_selector(process)


def test_the_kind_that_was_meant_is_named():
    with pytest.raises(LinkError) as raised:
        process_selector("nod:/talker")
    assert raised.value.fix == "Did you mean 'node'?"


@pytest.mark.parametrize("word", ["", "a\tb", "a\nb"])
def test_words_that_would_break_a_line_are_refused(word):
    with pytest.raises(LinkError, match="cannot be sent"):
        checked_words(["fine", word])


@pytest.mark.parametrize(
    ("selector", "expected"),
    [
        ("pid:7", True),
        ("pid:8", False),
        ("name:python3", True),
        ("name:talker.py", True),
        ("name:talker", False),
        ("node:/talker", True),
        ("node:talker", True),
        ("node:/talk", False),
    ],
)
def test_a_process_is_matched_by_its_name_its_script_or_its_node(selector, expected):
    words = ["/usr/bin/python3", "/opt/talker.py", "--ros-args", "-r", "__node:=talker"]
    assert matches(selector, 7, "python3", words) is expected


@pytest.mark.parametrize(
    ("selector", "expected"),
    [("node:/alice/ear", True), ("node:alice/ear", True), ("node:/bob/ear", False), ("node:/alice/eye", False)],
)
def test_a_node_in_a_namespace_is_found_by_both_as_launch_files_give_them(selector, expected):
    words = ["/opt/listener", "--ros-args", "-r", "__node:=ear", "-r", "__ns:=/alice"]
    assert matches(selector, 7, "listener", words) is expected
    assert not matches(selector, 7, "listener", words[:-2]), "it is in no namespace"


@pytest.mark.parametrize("start", ["python3 /opt/ros/bin/ros2 run nav", "sudo", "/usr/bin/timeout 60", "gdb --args"])
def test_a_program_that_starts_a_node_and_waits_for_it_is_not_the_node(start):
    node = ["/opt/talker", "--ros-args", "-r", "__node:=talker"]
    assert matches("node:/talker", 7, "talker", node)
    assert not matches("node:/talker", 7, start.split()[0], [*start.split(), *node])


@pytest.mark.parametrize(
    ("words", "selector", "expected"),
    [
        ("python3 -u -X dev nav/planner.py", "name:planner.py", True),
        ("python3 -m nav.planner --map hall", "name:nav.planner", True),
        ("python3 -m nav.planner planner.py", "name:planner.py", False),
        ("bash -e ./start.sh", "name:start.sh", True),
        ("bash -lc /opt/talker", "name:talker", False),  # the program that it starts has that name
        ("bash --norc start.sh", "name:start.sh", True),
        ("python3 -V", "name:-V", False),
        ("planner -m hall", "name:hall", False),
    ],
)
def test_a_script_is_found_behind_the_options_of_its_interpreter_and_a_module_by_its_name(words, selector, expected):
    given = words.split()
    assert matches(selector, 7, given[0], given) is expected
    assert (selector[5:] in names_of(given, "python3")) is expected, "over ssh"


def test_a_ros_1_node_is_found_by_its_name():
    assert matches("node:/talker", 7, "talker", ["/opt/talker", "__name:=talker", "__log:=/tmp/x"])
