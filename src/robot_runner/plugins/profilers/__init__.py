"""The built-in plugins that measure, and what a `CommandProfiler` and a `PowerModel` are told."""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.meters.battery import Battery as Battery
    from robot_runner.meters.codecarbon import CodeCarbon as CodeCarbon
    from robot_runner.meters.command import CommandProfiler as CommandProfiler
    from robot_runner.meters.command_meters import EnergiBridge as EnergiBridge
    from robot_runner.meters.command_meters import PowerJoular as PowerJoular
    from robot_runner.meters.command_meters import Powermetrics as Powermetrics
    from robot_runner.meters.command_output import Aggregate as Aggregate
    from robot_runner.meters.command_output import CommandColumn as CommandColumn
    from robot_runner.meters.command_output import TimeColumn as TimeColumn
    from robot_runner.meters.command_output import TimeKind as TimeKind
    from robot_runner.meters.command_output import parse_csv as parse_csv
    from robot_runner.meters.ina219.card import CardRecording as CardRecording
    from robot_runner.meters.ina219.card import read_card as read_card
    from robot_runner.meters.ina219.profiler import Ina219 as Ina219
    from robot_runner.meters.joulescope import Joulescope as Joulescope
    from robot_runner.meters.lab_camera import LabCamera as LabCamera
    from robot_runner.meters.linux_thermal import LinuxThermal as LinuxThermal
    from robot_runner.meters.machine.machine_watch import MachineWatch as MachineWatch
    from robot_runner.meters.network import Network as Network
    from robot_runner.meters.nvml import Nvml as Nvml
    from robot_runner.meters.perf_stat import PerfStat as PerfStat
    from robot_runner.meters.power_model.power_model import PowerModel as PowerModel
    from robot_runner.meters.power_model.states import RobotState as RobotState
    from robot_runner.meters.power_rails import PowerRails as PowerRails
    from robot_runner.meters.prometheus import Prometheus as Prometheus
    from robot_runner.meters.psutil import PsUtil as PsUtil
    from robot_runner.meters.rapl import Rapl as Rapl
    from robot_runner.meters.scpi import Scpi as Scpi
    from robot_runner.meters.scraped_metric import ScrapedMetric as ScrapedMetric
    from robot_runner.meters.smart_plug import SmartPlug as SmartPlug
    from robot_runner.meters.watts_up_pro import WattsUpPro as WattsUpPro
    from robot_runner.ros.ros_bag import RosBag as RosBag
    from robot_runner.ros.ros_graph import RosGraph as RosGraph
    from robot_runner.ros.ros_topics import RosTopics as RosTopics
    from robot_runner.ros.topic_latency import TopicLatency as TopicLatency
else:
    __getattr__, __dir__ = open_door(__name__)
