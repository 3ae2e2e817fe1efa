"""The bytes of the services of parameters are those that Cyclone DDS itself makes of types written by hand."""
# Without deferred annotations: cyclonedds does not find built-in types in them.

from dataclasses import dataclass

import pytest

from robot_runner.core.links.robot import Encoding
from robot_runner.ros.parameter_values import as_wire
from robot_runner.ros.shapes import completed
from robot_runner.ros.type_catalogue import TypeCatalogue

pytest.importorskip("cyclonedds", reason="it is not published built for every machine")

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int64, sequence, uint8


# rcl_interfaces/msg/ParameterValue, Parameter and srv/SetParameters, as github.com/ros2/rcl_interfaces defines them.
@dataclass
class ParameterValue(IdlStruct, typename="rcl_interfaces.msg.dds_.ParameterValue_"):
    type_: uint8 = 0
    bool_value: bool = False
    integer_value: int64 = 0
    double_value: float64 = 0.0
    string_value: str = ""
    byte_array_value: sequence[uint8] = ()
    bool_array_value: sequence[bool] = ()
    integer_array_value: sequence[int64] = ()
    double_array_value: sequence[float64] = ()
    string_array_value: sequence[str] = ()


@dataclass
class Parameter(IdlStruct, typename="rcl_interfaces.msg.dds_.Parameter_"):
    name: str
    value: ParameterValue


@dataclass
class Request(IdlStruct, typename="rcl_interfaces.srv.dds_.SetParameters_Request_"):
    parameters: sequence[Parameter]


def test_values_of_every_kind_are_laid_out_as_cyclone_dds_does_it():
    kinds = ("bool", "integer", "double", "string", "byte_array")
    kinds += ("bool_array", "integer_array", "double_array", "string_array")
    values = [True, -7, 0.25, "mäp", b"\x00\xff\x07", [True, False, True], [1, -(2**40)], [0.5], ["a", "", "bcd"]]
    theirs, ours = [], []
    for number, (kind, value) in enumerate(zip(kinds, values, strict=True), start=1):
        given = list(value) if isinstance(value, bytes) else value
        theirs.append(Parameter(kind, ParameterValue(number, **{f"{kind}_value": given})))
        ours.append({"name": kind, "value": as_wire(value)})
    catalogue = TypeCatalogue.of(2)
    complete = completed(catalogue.request("rcl_interfaces/SetParameters"), {"parameters": ours}, where="test")
    made = catalogue.serialise("rcl_interfaces/SetParameters_Request", complete, Encoding.CDR)
    expected = Request(theirs).serialize()
    assert made[4:] == expected[4:]
    assert catalogue.deserialise("rcl_interfaces/SetParameters_Request", expected, Encoding.CDR) == complete
