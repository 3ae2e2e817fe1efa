"""A bag, read by rosbags topic by topic: a topic that cannot be read does not affect the others."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import PluginError
from robot_runner.core.links.robot import Encoding
from robot_runner.ros.shapes import plain_type
from robot_runner.ros.type_store import type_hash

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: What installs the packages that read and write bags.
INSTALL = "Install it: pip install 'robot-runner[bag]'."
#: Separates the definition of a type from those that it is made of, and several files of IDL.
_RULE = "=" * 80 + "\n"
#: Lines such as `#include`, which the parser of rosbags does not know; the bag has the included definitions anyway.
_DIRECTIVE = re.compile(r"^[ \t]*#.*$", re.MULTILINE)

#: A line with a constant: its name, and its value up to a comment; in a string, `#` begins none.
_CONSTANT = re.compile(r"^[ \t]*(?:w?string[ \t]+(\w+)[ \t]*=(.*)|\w+[ \t]+(\w+)[ \t]*=([^#\n]*).*)$", re.MULTILINE)


class OpenedBag:
    """The reader of a `.bag`, `.mcap` or `.db3` file, or a folder of a bag of ROS 2, and the types of its messages.

    rosbags has a reader for both generations, too (`AnyReader`). It refuses a bag for one definition that it cannot
    parse, and in a folder it skips messages whose QoS differs between `metadata.yaml` and the file.

    Attributes:
        encoding: of its messages; it follows from the generation of ROS.
        connections: of rosbags; a topic may have several.
        store: the types that the bag defines, or those of Humble where a bag of ROS 2 defines none.
        faults: why a definition cannot be used, by type.
        count: how many messages there are.
        begin_ns, end_ns: when its first and its last message were recorded, ns since the epoch; 0 of an empty bag.

    Raises:
        PluginError: the library that reads the bag is not installed.
        Exception: the bag cannot be read; the class depends on the library with which rosbags unpacks it.
    """

    def __init__(self, path: Path) -> None:
        try:
            from rosbags.rosbag1 import Reader as Reader1  # noqa: PLC0415  # an extra
            from rosbags.rosbag2 import Reader as Reader2  # noqa: PLC0415  # an extra
        except ModuleNotFoundError as error:
            problem = f"bags cannot be read: {error.name} cannot be imported"
            raise PluginError(problem, where="PlayBag", fix=INSTALL) from error
        is_ros2 = path.is_dir() or path.suffix != ".bag"
        self.encoding = Encoding.CDR if is_ros2 else Encoding.ROS1
        self._opened = ExitStack()
        reader: Any = Reader2(path) if is_ros2 else Reader1(path)
        self._reader = self._opened.enter_context(reader)
        with ExitStack() as undoing:
            undoing.callback(self._opened.close)
            self.connections: Sequence[Any] = list(self._reader.connections)
            self.faults: dict[str, str] = {}
            self.store: Typestore = self._types()
            self.count: int = self._reader.message_count
            self.begin_ns: int = self._reader.start_time if self.count else 0
            # The end in rosbags is one nanosecond after the last message.
            self.end_ns: int = self._reader.end_time - 1 if self.count else 0
            undoing.pop_all()

    def close(self) -> None:
        """Close the file; closing twice does nothing."""
        self._opened.close()

    @property
    def has_no_index(self) -> bool:
        """Whether it has MCAP without chunks, where messages out of order are refused only as they are come to."""
        storage = getattr(self._reader, "storage", None)
        return any(getattr(each, "chunks", None) == [] for each in self._parts or [storage])

    @property
    def filed(self) -> Mapping[str, Any]:
        """The connections in the files of a folder that have messages, whatever `metadata.yaml` tells, by topic."""
        return {each.topic: each for part in self._parts for each in part.connections if each.msgcount}

    @property
    def _parts(self) -> Sequence[Any]:
        """The readers of the files of a folder; none of a bag that is a file."""
        return getattr(getattr(self._reader, "storage", None), "storages", ())

    def raw_messages(self, connections: Iterable[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, time in ns since the epoch, and bytes of each message, in their order."""
        wanted = [each for connection in connections for each in self._as_filed(connection)]
        if wanted:  # rosbags would take an empty list for all
            yield from self._reader.messages(wanted)

    def deserialised(self, message_type: str, data: bytes) -> object:
        """Return the bytes of a message as an object of the store."""
        is_cdr = self.encoding is Encoding.CDR
        return (self.store.deserialize_cdr if is_cdr else self.store.deserialize_ros1)(data, message_type)

    def _as_filed(self, connection: Any) -> list[Any]:
        """Return the connections in the files of the folder for one from `metadata.yaml`.

        The reader of a folder identifies a connection in the files by its QoS, too.
        """
        if not self._parts:
            return [connection]
        found: list[Any] = []
        for each in (each for part in self._parts for each in part.connections):
            filed = connection._replace(ext=each.ext, digest=each.digest)
            if (each.topic, each.msgtype) == (connection.topic, connection.msgtype) and filed not in found:
                found.append(filed)
        return found

    def _types(self) -> Typestore:
        from rosbags.interfaces import MessageDefinitionFormat  # noqa: PLC0415  # an extra
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415  # an extra

        defined = [each for each in self.connections if each.msgdef.format is not MessageDefinitionFormat.NONE]
        if not defined:
            # Bags of ROS 2 before Iron, as sqlite3 files, do not hold the definitions of their types.
            return get_typestore(Stores.ROS2_HUMBLE)
        store, types = get_typestore(Stores.EMPTY), dict[str, Any]()
        digests: Mapping[str, set[str]] = defaultdict(set)
        for each in defined:
            try:
                types.update(_parsed(each.msgtype, each.msgdef.data, each.msgdef.format))
            except Exception:  # noqa: BLE001  # of a parser, for what anybody wrote
                self.faults[each.msgtype] = "cannot be read"
            else:
                digests[each.msgtype].update({each.digest} - {"", "*"})
        store.register(types)
        for message_type, told in digests.items():
            if told and not told <= self._digests(store, message_type):
                self.faults[message_type] = "is another one than that by which its messages were written"
        return store

    def _digests(self, store: Typestore, message_type: str) -> set[str]:
        try:
            if self.encoding is Encoding.CDR:  # rosidl's, and that of rosbags, which may have written the bag
                return {type_hash(store, message_type), store.hash_rihs01(message_type)}
            return {store.generate_msgdef(message_type)[1]}
        except Exception:  # noqa: BLE001  # a part of the type is not defined
            return set()


def types_in(definition: str, message_type: str) -> dict[str, Any]:
    """Return the types of a definition, for a store, with constants as they are written.

    In ROS 1, a digest is of their text, which rosbags writes anew: 1e-3 would be 0.001.

    Raises:
        TypesysError: of rosbags; the definition cannot be read.
    """
    from rosbags.typesys import get_types_from_msg  # noqa: PLC0415  # an extra

    written: dict[str, dict[str, str]] = {}
    for part in f"MSG: {plain_type(message_type)}\n{definition}".split(_RULE):
        head, _, text = part.partition("\n")
        found = (each.groups() for each in _CONSTANT.finditer(text))
        written[head.removeprefix("MSG:").strip()] = {
            text_name or name: (text_value or value or "").strip() for text_name, text_value, name, value in found
        }
    types: dict[str, Any] = {}
    for each, (constants, fields) in get_types_from_msg(definition, message_type).items():
        own = written.get(plain_type(each), {})
        types[each] = [(name, kind, own.get(name, value)) for name, kind, value in constants], fields
    return types


def _parsed(message_type: str, text: str, kind: Any) -> Mapping[str, Any]:
    from rosbags.interfaces import MessageDefinitionFormat  # noqa: PLC0415  # an extra
    from rosbags.typesys import get_types_from_idl  # noqa: PLC0415  # an extra

    if kind is MessageDefinitionFormat.MSG:
        return types_in(text, message_type)
    text = _DIRECTIVE.sub("", text)
    if not text.startswith(f"{_RULE}IDL: "):
        return get_types_from_idl(text)
    files = (part.partition("\n")[2] for part in text.split(_RULE)[1:])
    return {name: fields for each in files for name, fields in get_types_from_idl(each).items()}
