"""What is put back at a real master of ROS 1 of the parameters that a launch sets."""

from __future__ import annotations

import ast
import subprocess
import sys
import xmlrpc.client
from contextlib import closing
from itertools import permutations, product
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.ros.ros1_master import needs_ros1, ros1_environment, ros1_master
from tests.subjects.test_ros_launch import needs_roslaunch

from robot_runner.subjects import launched_parameters

if TYPE_CHECKING:
    from collections.abc import Iterator

SETS = """\
<launch>
  <param name="/use_sim_time" value="true"/>
  <node name="nav" pkg="nav" type="nav.py" ns="alice">
    <rosparam>{limits: {speed: [0.1, 0.2], none: {}}, "d e": 3, "1: x": 1}</rosparam>
    <param name="text" value="/no/name: 1&#10;/nor/this: 2"/>
  </node>
</launch>
"""


class Nav:
    """A launch at a master, as `RosLaunch` has it kept and put back."""

    def __init__(self, folder: Path, uri: str) -> None:
        self._environment = ros1_environment(uri, folder)
        self._server = xmlrpc.client.ServerProxy(uri)

    def close(self) -> None:
        self._server("close")()

    def execute(self, *command: str, key: str = "nav") -> subprocess.CompletedProcess[str]:
        words = [sys.executable, launched_parameters.__file__, key, *command]
        return subprocess.run(words, env=self._environment, check=False, capture_output=True, text=True)

    def set(self, name: str, value: object) -> None:
        self._server.setParam("/test", name, value)

    def has(self) -> dict[str, object]:
        everything = self._server.getParam("/test", "/")[2]
        return {name: everything[name] for name in ("nav", "robot_runner_kept") if everything.get(name)}


@pytest.fixture
def nav(tmp_path: Path) -> Iterator[Nav]:
    with ros1_master(tmp_path) as uri, closing(Nav(tmp_path, uri)) as nav:
        yield nav


def dumping(*names: str) -> list[str]:
    return ["printf", "%s: 1\\n", *names]


@pytest.mark.long
@needs_ros1
def test_what_a_launch_sets_is_as_it_was_before_once_it_has_ended(nav: Nav) -> None:
    nav.set("/nav/speed", [1, "a", {"deep": True}])
    before = nav.has()
    assert nav.execute(*dumping("/nav/speed", "/nav/limits/turn")).returncode == 0
    nav.set("/nav/speed", 2)
    nav.set("/nav/limits/turn", 0.5)
    assert nav.execute().returncode == 0
    assert nav.has() == {"nav": {**before["nav"], "limits": {}}}


@pytest.mark.long
@needs_ros1
def test_what_a_killed_run_has_set_is_put_back_before_the_next_start(nav: Nav) -> None:
    nav.execute(*dumping("/nav/inflation"))
    nav.set("/nav/inflation", 0.9)
    nav.execute(*dumping("/nav/speed"))
    assert "nav" not in nav.has()
    nav.set("/nav/speed", 1)
    nav.execute()
    nav.execute()  # once more changes nothing
    assert nav.has() == {}


@pytest.mark.long
@needs_ros1
@pytest.mark.parametrize(
    ("ending", "had"),
    [
        pytest.param(*each, marks=[] if each in {("acb", 0), ("bca", None), ("cab", 0)} else pytest.mark.soak)
        for each in product(map("".join, permutations("abc")), [0, None])
    ],
)
def test_launches_that_set_the_same_end_in_any_order_and_none_takes_it_from_another(
    nav: Nav, ending: str, had: int | None
) -> None:
    if had is not None:
        nav.set("/nav/speed", had)
    before = nav.has()
    for value, key in enumerate("abc", start=1):
        nav.execute(*dumping("/nav/speed"), key=key)
        nav.set("/nav/speed", value)
    left = "abc"
    for key in ending:
        assert nav.execute(key=key).returncode == 0
        left = left.replace(key, "")
        if left:
            assert nav.has()["nav"] == {"speed": "abc".index(left[-1]) + 1}, (
                "as the last of those that go on has set it"
            )
    assert nav.has() == before


@pytest.mark.long
@needs_ros1
def test_what_an_earlier_version_has_kept_is_put_back(nav: Nav) -> None:
    nav.set("/nav/speed", 2)
    nav.set("/robot_runner_kept/nav", [["/nav/speed", [1]], ["/nav/turn", []]])
    nav.set("/nav/turn", 0.5)
    nav.execute()
    assert nav.has() == {"nav": {"speed": 1}}


@pytest.mark.long
@needs_roslaunch
def test_all_that_a_launch_file_sets_is_known_by_name(tmp_path: Path) -> None:
    file = tmp_path / "nav.launch"
    file.write_text(SETS)
    assert set(launched_parameters.names_of(["roslaunch", "--dump-params", str(file)])) == {
        "/use_sim_time", "/alice/nav/limits/speed", "/alice/nav/d e", "/alice/nav/text", "/alice/nav/1: x"
    }  # fmt: skip


def test_the_python_of_an_old_robot_reads_it() -> None:
    ast.parse(Path(launched_parameters.__file__).read_text(encoding="utf-8"), feature_version=(3, 6))


def test_a_launch_that_brings_its_own_master_is_left_alone(tmp_path: Path) -> None:
    with closing(Nav(tmp_path, "http://127.0.0.1:9")) as nobody:
        assert nobody.execute(*dumping("/nav/speed")).returncode == 0
