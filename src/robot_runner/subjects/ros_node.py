"""The subject that is one node of ROS 1 or ROS 2."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape, quoteattr

from robot_runner.core.errors import Finding, LinkError, PluginError, did_you_mean
from robot_runner.core.links.connect import robot_namespace
from robot_runner.core.links.graph_names import namespace_prefix
from robot_runner.core.storage.input_files import InputFile
from robot_runner.subjects.read_files import with_what_it_names
from robot_runner.subjects.ros_subject import RosSubject
from robot_runner.subjects.surroundings import holds_revision, word

if TYPE_CHECKING:
    from robot_runner.core.events.context import ExperimentContext

_GRAPH_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: A character beyond the first 65,536, such as an emoji, as JSON writes it.
_PAIR = re.compile(r"\\ud[89ab]..\\ud[c-f]..")
_PARAMETER = re.compile(r"[A-Za-z0-9_./~-]+")
#: roslaunch reads the launch file of the one node from its input, wherever it is executed; the file is its `$0`.
_FROM_INPUT = "exec roslaunch - <<END\n$0\nEND\n"
#: roslaunch tells from a file alone what it sets, and the command of a node, for which it looks for the executable.
_ASK = 'file=$(mktemp) && printf %s "$0" >"$file" && roslaunch "$1" "$file"; code=$?; rm -f "$file"; exit $code'
#: What it says of them, among a traceback.
_REFUSED = re.compile(
    r"Cannot locate node of type [^\n]*?\] in package [^\n]*?\]|[^\n]*does not exist[^\n]*|(ResourceNotFound: \S+)"
)


class RosNode(RosSubject):
    """Starts one node of a package, with parameters and remappings of its own, and ends it as Ctrl-C would.

    In ROS 2 it is `ros2 run`; in ROS 1 `roslaunch`, with a launch file of this one node. `treatment(...)` may stand for
    any value: of the package, the executable, an argument, a parameter, a remapping, the middleware (`rmw`).

    Args:
        package: the package that has the executable.
        executable: its name there.
        arguments: of the executable itself.
        parameters: of the node, by name; nested ones in mappings, or with dots in the name, which are slashes in ROS 1.
        parameters_file: a YAML file of parameters, or several; a path where the node is executed.
        remappings: the new name for each name that the node uses.
        node_name: the name of the node; left out, its own default (ROS 2), or that of the executable (ROS 1).
        namespace: which it is started in, such as `/alice`; below that of the run's robot (`robot = "ros2://alice"`),
            but where it is started once for all runs.
        **options: `ros` and `rmw`, as of every `RosSubject`, and those of every `Subject`.

    Raises:
        PluginError: it is not clear which ROS is meant, or a parameter cannot be.

    Example:
        >>> RosNode("nav", "planner", parameters={"speed": 0.2}, remappings={"scan": "/front/scan"}, ros=2).words()[4:]
        ('--ros-args', '-r', 'scan:=/front/scan', '-p', 'speed:=0.2')
    """

    def __init__(
        self,
        package: str,
        executable: str,
        *,
        arguments: Sequence[Any] = (),
        parameters: Mapping[str, Any] | None = None,
        parameters_file: Any = (),
        remappings: Mapping[str, str] | None = None,
        node_name: str | None = None,
        namespace: str = "",
        **options: Any,
    ) -> None:
        super().__init__(**options)
        files = [*parameters_file] if isinstance(parameters_file, list | tuple) else [parameters_file]
        if isinstance(arguments, str):
            raise PluginError(f"arguments is {arguments!r}", where=self.name, fix=f"Give a list: [{arguments!r}].")
        if node_name is not None and not _GRAPH_NAME.fullmatch(str(node_name)):
            fix = "Use letters, digits and '_', and give the namespace apart."
            raise PluginError(f"a node cannot be named {node_name!r}", where=self.name, fix=fix)
        try:
            self.namespace = namespace_prefix(namespace)
        except LinkError as error:
            raise PluginError(error.problem, where=self.name, fix=error.fix) from error
        self._started_in = self.namespace
        self.package, self.executable = word(self.name, package), word(self.name, executable)
        self.arguments = tuple(word(self.name, each) for each in arguments)
        self.parameters = dict(_flat(self.name, parameters or {}))
        self.parameters_files = tuple(word(self.name, each) for each in files)
        self.remappings = {word(self.name, old): word(self.name, new) for old, new in (remappings or {}).items()}
        self.node_name = node_name
        self._own_files = tuple(word(self.name, each) for each in files if not holds_revision(each))
        self._named = (package, executable, *files)

    def prepare_start(self, context: ExperimentContext) -> None:
        """Start it in the namespace of the run's robot, unless several robots may share it."""
        if self._is_of_run:
            self._started_in = robot_namespace(context, self.namespace)
        super().prepare_start(context)

    @property
    def stops_group(self) -> bool:
        """As `ros2 run` awaits the end of the node, and hands no signal on to it."""
        return self.ros != 1

    def words(self) -> tuple[str, ...]:
        """Return the command."""
        return ("sh", "-c", _FROM_INPUT, self._launch_file()) if self.ros == 1 else self._run()

    def dumping(self) -> tuple[str, ...]:
        """Return the command that writes the parameters which it sets at the master of ROS 1."""
        return ("sh", "-c", _ASK, self._launch_file(), "--dump-params")

    def files_read(self) -> Iterable[InputFile]:
        """Yield the files of parameters."""
        paths = map(self.surroundings.own_path, self._own_files)
        return [with_what_it_names(path) for path in paths if path is not None]

    def ros_findings(self, where: str) -> Iterable[Finding]:
        """Yield errors: no such package, no such executable in it, or no file of parameters."""
        if self.ros == 1:
            name = f"{self._started_in}/{self._name_in_ros1}"
            answer = self.surroundings.ask(("sh", "-c", _ASK, self._launch_file(), f"--args={name}"))
            if answer.code != 0:
                found = [*_REFUSED.finditer(answer.complaint)]  # the last one: before it stands a line of its source
                told = answer._replace(complaint=(found[-1][1] or found[-1][0]).strip()) if found else answer
                yield self.refused(where, f"{self.package}/{self.executable}", told)
            return
        yield from self._executable_findings(where)
        for file in self.parameters_files:
            if self.surroundings.ask(("test", "-f", file)).code != 0:
                yield Finding.error(where, f"there is no file of parameters {file!r}", "Name one that is there.")

    def _executable_findings(self, where: str) -> Iterator[Finding]:
        listed = self.surroundings.ask(("ros2", "pkg", "executables", self.package))
        names = [line.split()[-1] for line in listed.said.splitlines() if len(line.split()) > 1]
        if listed.code != 0:
            yield self.refused(where, self.package, listed)
        elif self.executable not in names:
            fix = did_you_mean(self.executable, names) or "Build it: the package has no executable."
            yield Finding.error(where, f"the package {self.package!r} has no executable {self.executable!r}", fix)

    @property
    def _name_in_ros1(self) -> str:
        return self.node_name or re.sub(r"\W", "_", self.executable.rpartition(".")[0] or self.executable)

    def _run(self) -> tuple[str, ...]:
        """Return the words of `ros2 run` (design.ros2.org, command line arguments)."""
        rules = [f"{old}:={new}" for old, new in self.remappings.items()]
        rules += [f"__node:={self.node_name}"] if self.node_name is not None else []
        rules += [f"__ns:={self._started_in}"] if self._started_in else []
        options = [each for rule in rules for each in ("-r", rule)]
        options += [each for file in self.parameters_files for each in ("--params-file", file)]
        options += [each for name, value in self.parameters.items() for each in ("-p", f"{name}:={_yaml(value)}")]
        ros_args = ("--ros-args", *options) if options else ()
        return ("ros2", "run", self.package, self.executable, *self.arguments, *ros_args)

    def _launch_file(self) -> str:
        """Return a launch file of this one node, whose end is that of roslaunch (wiki.ros.org/roslaunch/XML)."""
        facts = {
            "pkg": self.package,
            "type": self.executable,
            "name": self._name_in_ros1,
            "args": shlex.join(self.arguments),  # which roslaunch splits as a shell would
            "ns": self._started_in.strip("/"),
            "output": "screen",
            "required": "true",
        }
        lines = [f"<remap from={quoteattr(old)} to={quoteattr(new)}/>" for old, new in self.remappings.items()]
        files = map(self.surroundings.found, self.parameters_files)
        lines += [f'<rosparam command="load" file={quoteattr(file)}/>' for file in files]
        lines += [
            f"<rosparam param={quoteattr(name.replace('.', '/'))}>{escape(_yaml(value))}</rosparam>"
            for name, value in self.parameters.items()
        ]
        attributes = " ".join(f"{name}={quoteattr(value)}" for name, value in facts.items() if value)
        return f"<launch><node {attributes}>{''.join(lines)}</node></launch>"


def _yaml(value: Any) -> str:
    """Return a value as YAML: as JSON, where the text "1" stays a text, but for numbers such as 1e-06.

    YAML 1.1, which PyYAML and so rosparam reads, takes a number without a point for a text, and a character that JSON
    writes as two for two characters.
    """
    if isinstance(value, list):
        return f"[{', '.join(map(_yaml, value))}]"
    text = json.dumps(value)
    if isinstance(value, str):
        return _PAIR.sub(_of_yaml, text)
    return text.replace("e", ".0e") if isinstance(value, float) and "." not in text else text


def _of_yaml(pair: re.Match[str]) -> str:
    character: str = json.loads(f'"{pair[0]}"')
    return f"\\U{ord(character):08x}"


def _flat(plugin: str, parameters: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each parameter with its full name.

    Raises:
        PluginError: a name or a value cannot be that of a parameter.
    """
    for name, value in parameters.items():
        full = f"{prefix}{name}"
        if not _PARAMETER.fullmatch(full):
            fix = "Use letters, digits and '_'."
            raise PluginError(f"{full!r} is not the name of a parameter", where=plugin, fix=fix)
        if isinstance(value, Mapping):
            yield from _flat(plugin, value, f"{full}.")
        elif _is_value(value):
            yield full, list(value) if isinstance(value, tuple) else value
        else:
            fix = "Give a number, a text, a truth value, or a list of them."
            raise PluginError(f"the parameter {full!r} cannot be {value!r}", where=plugin, fix=fix)


def _is_value(value: object) -> bool:
    if isinstance(value, list | tuple):
        return all(_is_value(each) and not isinstance(each, list | tuple) for each in value)
    return isinstance(value, str | bool | int) or (isinstance(value, float) and math.isfinite(value))
