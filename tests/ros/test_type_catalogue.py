"""Types of messages and services: their shapes, definitions, digests and bytes."""

from __future__ import annotations

import math
import re

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding
from robot_runner.ros.shapes import UNBOUNDED, completed
from robot_runner.ros.type_catalogue import TypeCatalogue


@pytest.fixture(params=[(1, Encoding.ROS1), (2, Encoding.CDR)], ids=["ros1", "ros2"])
def generation(request):
    return request.param


def _written(folder, name, text):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_the_header_of_ros_1_counts_its_messages_and_that_of_ros_2_does_not():
    assert TypeCatalogue.of(1).shape("std_msgs/Header").names == ("seq", "stamp", "frame_id")
    assert TypeCatalogue.of(2).shape("std_msgs/Header").names == ("stamp", "frame_id")


def test_the_catalogue_of_a_check_which_knows_no_distribution_is_that_of_the_runs_which_are_told_the_latest():
    assert TypeCatalogue.of(2) is TypeCatalogue.of(2, "jazzy")


def test_an_array_has_its_length_and_a_sequence_none():
    shape = TypeCatalogue.of(2).shape("sensor_msgs/Imu")
    counts = {field.name: field.count for field in shape.fields}
    assert counts["orientation_covariance"] == 9
    assert TypeCatalogue.of(2).shape("sensor_msgs/LaserScan").fields[-1].count == UNBOUNDED


def test_a_type_with_a_text_of_wide_characters_is_refused_with_what_to_do(tmp_path):
    file = _written(tmp_path, "msg/Label.msg", "wstring<=5[] names")
    with pytest.raises(LinkError, match=r"'names' of .*/msg/Label is a wstring, which only rclpy can send") as refused:
        TypeCatalogue.of(2, "jazzy", (file,))
    assert "over ros2" in refused.value.fix


def test_an_orientation_that_is_left_out_is_none_at_all_in_ros_2_only():
    for number, w in ((1, 0.0), (2, 1.0)):
        shape = TypeCatalogue.of(number).shape("geometry_msgs/Pose")
        assert completed(shape, {}, where="goal")["orientation"]["w"] == w


@pytest.mark.parametrize(("distro", "status"), [("humble", 0), ("jazzy", -2), ("kilted", -2)])
def test_a_satellite_fix_of_which_nothing_is_told_is_unknown_since_jazzy(distro, status):
    shape = TypeCatalogue.of(2, distro).shape("sensor_msgs/NavSatFix")
    assert completed(shape, {}, where="fix")["status"]["status"] == status


# The sums that rosmsg prints on ROS 1 Noetic, and the hashes in rosidl's generated JSON files of ROS 2.
@pytest.mark.parametrize(
    ("number", "name", "digest"),
    [
        (1, "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1"),
        (1, "nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7"),
        (1, "geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a"),
        (1, "ackermann_msgs/AckermannDrive", "3512e91b48d69674a0e86fadf1ea8231"),
        (1, "ackermann_msgs/AckermannDriveStamped", "1fd5d7f58889cefd44d29f6653240d0c"),
        (2, "std_msgs/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        (2, "std_msgs/Char", "RIHS01_3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9"),
        (2, "rmw_dds_common/Gid", "RIHS01_ab6f21cfbb0a6dbb837161e1110c2051a2850ed9f9c53944d7115d9bcebedf71"),
    ],
)
def test_digests_are_those_of_ros(number, name, digest):
    assert TypeCatalogue.of(number).digest(name) == digest


def test_a_definition_is_followed_by_those_that_it_is_made_of():
    text = TypeCatalogue.of(1).definition("nav_msgs/Odometry")
    assert text.startswith("std_msgs/Header header\nstring child_frame_id\n")
    assert "=" * 80 + "\nMSG: geometry_msgs/Quaternion\n" in text


def test_the_feedback_of_an_action_has_a_definition_as_any_topic_has():
    first, *others = TypeCatalogue.of(2).definition("nav2_msgs/NavigateToPose_FeedbackMessage").split(f"{'=' * 80}\n")
    assert first == "unique_identifier_msgs/UUID goal_id\nnav2_msgs/NavigateToPose_Feedback feedback\n"
    (feedback,) = (each for each in others if each.startswith("MSG: nav2_msgs/NavigateToPose_Feedback\n"))
    assert "builtin_interfaces/Duration navigation_time\n" in feedback


def test_a_message_is_what_its_bytes_were_made_of(generation):
    number, encoding = generation
    catalogue = TypeCatalogue.of(number)
    image = {
        "header": {"stamp": {"sec": 12, "nanosec": 345}, "frame_id": "caméra"},
        "height": 1,
        "data": b"\x00\xff",
        "encoding": "mono8",
    }
    markers = {"markers": [{"ns": "a", "points": [{"x": 1.0}, {"y": -2.5}], "colors": []}, {"ns": "b"}]}
    for name, message in (
        ("sensor_msgs/Image", image),
        ("visualization_msgs/MarkerArray", markers),
        ("sensor_msgs/JointState", {"name": ["left", "right"], "position": [0.5, -0.5]}),
        ("std_msgs/Empty", {}),
        ("diagnostic_msgs/DiagnosticStatus", {"values": [{"key": "a", "value": "b"}]}),
    ):
        whole = completed(catalogue.shape(name), message, where="a topic")
        data = catalogue.serialise(name, whole, encoding)
        assert catalogue.deserialise(name, data, encoding) == whole


def test_the_bytes_of_ros_1_are_packed_and_those_of_ros_2_aligned():
    message = {"data": "hi"}
    assert TypeCatalogue.of(1).serialise("std_msgs/String", message, Encoding.ROS1) == b"\x02\0\0\0hi"
    assert TypeCatalogue.of(2).serialise("std_msgs/String", message, Encoding.CDR) == b"\0\1\0\0\x03\0\0\0hi\0"


def test_a_byte_has_a_sign_in_ros_1_and_none_in_ros_2():
    ros1, ros2 = TypeCatalogue.of(1), TypeCatalogue.of(2)
    assert ros1.deserialise("std_msgs/Byte", b"\xff", Encoding.ROS1) == {"data": -1}
    assert ros2.deserialise("std_msgs/Byte", b"\0\1\0\0\xff", Encoding.CDR) == {"data": 255}
    numbers = {"layout": {"dim": [], "data_offset": 0}, "data": [-1, 1]}
    data = ros1.serialise("std_msgs/ByteMultiArray", numbers, Encoding.ROS1)
    assert data[-2:] == b"\xff\x01"
    assert ros1.deserialise("std_msgs/ByteMultiArray", data, Encoding.ROS1) == numbers


def test_standard_services_are_known(generation):
    number, encoding = generation
    catalogue = TypeCatalogue.of(number)
    assert catalogue.request("std_srvs/Trigger").names == ()
    assert catalogue.response("std_srvs/SetBool").names == ("success", "message")
    data = catalogue.serialise("std_srvs/SetBool_Request", {"data": True}, encoding)
    assert catalogue.deserialise("std_srvs/SetBool_Request", data, encoding) == {"data": True}


def test_an_unknown_type_is_refused_with_the_nearest_one():
    catalogue = TypeCatalogue.of(2)
    with pytest.raises(LinkError, match="Did you mean 'nav_msgs/Odometry'"):
        catalogue.shape("nav_msgs/Odometri")
    with pytest.raises(LinkError, match="Did you mean 'std_srvs/Trigger'"):
        catalogue.request("std_srvs/Triger")
    with pytest.raises(LinkError, match=r"types="):
        catalogue.definition("my_robot/Battery")


def test_bytes_that_are_cut_off_are_refused(generation):
    number, encoding = generation
    catalogue = TypeCatalogue.of(number)
    whole = completed(catalogue.shape("nav_msgs/Odometry"), {}, where="odom")
    data = catalogue.serialise("nav_msgs/Odometry", whole, encoding)
    with pytest.raises(LinkError, match="50 bytes are not a message of this type"):
        catalogue.deserialise("nav_msgs/Odometry", data[:50], encoding)


def test_an_incomplete_message_is_refused():
    with pytest.raises(LinkError, match="as its definition says"):
        TypeCatalogue.of(2).serialise("geometry_msgs/Point", {"x": 1.0}, Encoding.CDR)


def test_types_come_from_the_user_s_files(tmp_path):
    _written(tmp_path, "my_robot/msg/Wheel.msg", "float32 speed 0.5  # rad/s\nuint8 FRONT=1\nuint8 place\n")
    _written(tmp_path, "my_robot/msg/Wheels.msg", "std_msgs/Header header\nWheel[2] pair\nWheel[<=3] more\n")
    _written(tmp_path, "my_robot/srv/Turn.srv", "Wheel wheel\n---\nbool done\n")
    catalogue = TypeCatalogue.of(2, extra=(tmp_path,))
    whole = completed(catalogue.shape("my_robot/Wheels"), {"pair": [{"place": 1}, {}]}, where="wheels")
    data = catalogue.serialise("my_robot/Wheels", whole, Encoding.CDR)
    assert catalogue.deserialise("my_robot/Wheels", data, Encoding.CDR)["pair"][0]["place"] == 1
    assert catalogue.request("my_robot/Turn").fields[0].kind.type_name == "my_robot/Wheel"
    assert "MSG: my_robot/Wheel" in catalogue.definition("my_robot/Wheels")


def test_fields_that_are_left_out_have_the_defaults_of_the_user_s_file(tmp_path):
    text = """# A goal.
float32 speed 0.25   # m/s
string mode "fast # and far"
string<=5 tag abc   # without quotes
bool on true
int32[] list [1, -2]
uint8 MODE=3
uint8 OTHER = 4
string LABEL=hello # all of it
int16 padded 010
float64 far inf
bool[2] both [false, TRUE]
string[] words ["a # b", 'c'] # two
int32 plain # 5
"""
    _written(tmp_path, "my_robot/msg/Goal.msg", text)
    _written(tmp_path, "my_robot/action/Drive.action", "float64 rate 0.5\n---\nbool done\n---\nint8 left 7\n")
    _written(tmp_path, "my_robot/srv/Ask.srv", "int8 level 2\n---\nint8 level 3\n")
    catalogue = TypeCatalogue.of(2, "jazzy", (tmp_path,))
    made = completed(catalogue.shape("my_robot/Goal"), {}, where="a")
    assert made.pop("speed") == 0.25
    assert (made.pop("padded"), made.pop("far")) == (10, math.inf)
    assert (made.pop("both"), made.pop("words")) == ([False, True], ["a # b", "c"])
    assert made == {"mode": "fast # and far", "tag": "abc", "on": True, "list": [1, -2], "plain": 0}
    assert completed(catalogue.shape("my_robot/Drive_Goal"), {}, where="a") == {"rate": 0.5}
    assert completed(catalogue.shape("my_robot/Drive_Feedback"), {}, where="a") == {"left": 7}
    assert completed(catalogue.request("my_robot/Ask"), {}, where="a") == {"level": 2}
    assert completed(catalogue.response("my_robot/Ask"), {}, where="a") == {"level": 3}
    assert len({catalogue.shape("my_robot/Goal")}) == 1  # it can be a key, as the DDS types are kept by it


@pytest.mark.parametrize("default", ["[1, x]", "5", "'abc'", "{[1]: 2}"])
def test_a_default_that_cannot_be_read_is_named_by_its_file(tmp_path, default):
    _written(tmp_path, "my_robot/msg/Goal.msg", f"int32[] plain {default}\n")
    problem = re.escape(f"the default of the field 'plain' cannot be read: {default!r}")
    with pytest.raises(LinkError, match=rf"Goal\.msg: {problem}"):
        TypeCatalogue.of(2, "jazzy", (tmp_path,))


def test_two_fields_of_one_name_are_refused_with_their_file(tmp_path):
    file = _written(tmp_path, "my_robot/msg/Goal.msg", "float32 speed\nint32 speed\n")
    with pytest.raises(LinkError, match=r"'my_robot/msg/Goal' has conflicting Python names: 'speed'") as refused:
        TypeCatalogue.of(2, "jazzy", (tmp_path,))
    assert refused.value.where == str(file)


def test_a_file_is_enough_and_its_folder_names_the_package(tmp_path):
    file = _written(tmp_path, "my_robot/Wheel.msg", "float32 speed\n")
    assert TypeCatalogue.of(1, extra=(file,)).shape("my_robot/Wheel").names == ("speed",)


@pytest.mark.parametrize("place", ["robot_msgs-main/msg/Wheel.msg", "robot_msgs-main/Wheel.msg"])
def test_a_package_in_a_folder_of_another_name_is_called_as_its_package_xml_says(tmp_path, place):
    file = _written(tmp_path, place, "float32 speed\n")
    _written(tmp_path, "robot_msgs-main/package.xml", "<package>\n  <name>robot_msgs</name>\n</package>\n")
    for extra in (file, tmp_path):
        assert TypeCatalogue.of(2, extra=(extra,)).shape("robot_msgs/Wheel").names == ("speed",)


@pytest.mark.parametrize("folder", ["robot_msgs-main", "3robots"])
def test_a_folder_that_cannot_be_the_name_of_a_package_is_told(tmp_path, folder):
    _written(tmp_path, f"{folder}/msg/Wheel.msg", "float32 speed\n")
    with pytest.raises(LinkError, match=f"{folder!r} is not the name of a package") as refused:
        TypeCatalogue.of(2, extra=(tmp_path,))
    assert "package.xml" in refused.value.fix


def test_a_type_of_the_distribution_may_be_given_again_by_its_own_file(tmp_path):
    text = "# of constants only\nuint8 PARAMETER_NOT_SET=0\nuint8 PARAMETER_BOOL=1\n"
    _written(tmp_path, "rcl_interfaces/msg/ParameterType.msg", text)
    assert "PARAMETER_BOOL" in TypeCatalogue.of(2, "humble", (tmp_path,)).definition("rcl_interfaces/ParameterType")


@pytest.mark.parametrize("generation", [1, 2])
def test_a_type_that_a_robot_tells_is_refused_where_one_that_it_is_made_of_is_known_otherwise(generation):
    catalogue = TypeCatalogue.of(generation)
    told = f"geometry_msgs/Vector3 push\n{'=' * 80}\nMSG: geometry_msgs/Vector3\n{{}}"
    learnt = catalogue.with_definition("lab_msgs/Reading", told.format("float64 x\nfloat64 y\nfloat64 z\n"))
    assert [field.name for field in learnt.shape("lab_msgs/Reading").fields] == ["push"]
    with pytest.raises(LinkError, match=r"geometry_msgs/msg/Vector3 is defined otherwise"):
        catalogue.with_definition("lab_msgs/Reading", told.format("float32 x\nfloat32 y\nfloat32 z\n"))


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("my_robot/msg/Wheel.msg", "float32 speed[\n", "cannot be read"),
        ("my_robot/msg/Wheel.msg", "Axle axle\n", "'my_robot/msg/Axle', which is not known"),
        ("my_robot/srv/Turn.srv", "bool now\n", "no line '---'"),
        ("geometry_msgs/msg/Twist.msg", "float64 x\n", "defined otherwise"),
    ],
)
def test_a_definition_that_cannot_be_used_is_named_by_its_file(tmp_path, name, text, problem):
    file = _written(tmp_path, name, text)
    with pytest.raises(LinkError) as caught:
        TypeCatalogue.of(2, extra=(tmp_path,))
    assert problem in caught.value.problem
    assert caught.value.where == str(file)


def test_two_files_of_one_type_have_to_say_the_same(tmp_path):
    _written(tmp_path, "install/my_robot/share/my_robot/msg/Wheel.msg", "float32 speed\nuint8 place\n")
    source = _written(tmp_path, "src/my_robot/msg/Wheel.msg", "# A wheel.\nfloat32   speed  # m/s\n\nuint8 place\n")
    assert TypeCatalogue.of(2, extra=(tmp_path,)).shape("my_robot/Wheel").names == ("speed", "place")
    source.write_text("uint8 place\nfloat32 speed\n")
    with pytest.raises(LinkError, match=r"my_robot/Wheel is defined otherwise in .*/install/.*Wheel\.msg") as caught:
        TypeCatalogue.of(2, "humble", (tmp_path,))
    assert caught.value.where == str(source)


def test_a_folder_without_definitions_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(LinkError, match=r"there is no"):
            TypeCatalogue.of(2, extra=(path,))


def test_an_unknown_distribution_is_refused():
    with pytest.raises(LinkError, match="Did you mean 'jazzy'"):
        TypeCatalogue.of(2, "jazy")


def test_a_text_in_another_encoding_is_told_as_such():
    latin1 = bytes([0, 1, 0, 0, 5, 0, 0, 0]) + "café".encode("latin-1") + b"\0"
    with pytest.raises(LinkError, match="'utf-8' codec can't decode byte 0xe9") as caught:
        TypeCatalogue.of(2).deserialise("std_msgs/String", latin1, Encoding.CDR)
    assert caught.value.fix.startswith("Have its node send texts in UTF-8")
