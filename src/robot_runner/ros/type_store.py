"""Fills a `rosbags` type store: types of a ROS distribution, those of the user's files, and the standard services."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.ros.action_types import action_parts, is_action_part, split_definition
from robot_runner.ros.bundled_types import bundled_definitions
from robot_runner.ros.definition_files import definition_files, package_of
from robot_runner.ros.message_codec import FILLER, NodeKind
from robot_runner.ros.shapes import plain_type

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: The distributions whose types are known. All of ROS 1's noetic series have the same messages.
ROS1_DISTROS = ("kinetic", "lunar", "melodic", "noetic")
ROS2_DISTROS = ("foxy", "galactic", "humble", "iron", "jazzy", "kilted")

#: The separator of several definitions in one text.
_NEXT = re.compile(r"^=+\nMSG: *", re.MULTILINE)

#: A field of texts that rosbags does not know, and its name.
_WIDE = re.compile(r"^[ \t]*wstring\b[^\s#]*[ \t]+(\w+)", re.MULTILINE)

#: The distribution of ROS 2 whose types are used if none is named.
LATEST = "jazzy"


def filled_store(generation: int, distro: str | None, extra: Sequence[Path]) -> Typestore:
    """Return a store with the types of a distribution (None: the latest), of the user's files and standard services.

    The files are `.msg`, `.srv` and `.action` files, or folders that are searched for them. A file's package is what
    the `package.xml` in the folder names that its `msg`, `srv` or `action` folder stands in, or else the one that it
    stands in itself; without a `package.xml`, the package is called like that folder.

    Raises:
        LinkError: `rosbags` is not installed, there is no such distribution, or a file cannot be used.
    """
    rosbags = _rosbags()
    store: Typestore = rosbags.get_typestore(_store_of(rosbags, generation, distro))
    definitions = _definitions(extra)
    for name, text in bundled_definitions(generation, distro or LATEST).items():
        definitions.setdefault(name, ("what is known without any ROS", text))
    found: dict[str, Any] = {}
    for name, (where, text) in definitions.items():
        found |= _parsed(rosbags, name, text, where, generation)
    for name in found.keys() & store.fielddefs.keys():
        _check_same(name, found[name], store, definitions)
    fresh = {name: fields for name, fields in found.items() if name not in store.fielddefs}
    _register(rosbags, store, fresh, definitions)
    _check_references(found, store, definitions)
    return store


def given_defaults(generation: int, extra: Sequence[Path]) -> dict[tuple[str, str], Any]:
    """Return the defaults that the user's files give to fields, by the type's name as stores spell it and the field's.

    Raises:
        LinkError: a file cannot be used; ROS 1 has no defaults.
    """
    found: dict[tuple[str, str], Any] = {}
    for name, (where, text) in _definitions(extra).items() if generation == 2 else ():  # noqa: PLR2004  # of ROS
        for stored, part in _parts(name, text, where, generation).items():
            found |= {(stored, field): value for field, value in field_defaults(part, where=where).items()}
    return found


def with_definition(store: Typestore, name: str, text: str) -> tuple[Typestore, dict[tuple[str, str], Any]]:
    """Return a store that also has a message type and the types of its fields, and the defaults of their fields.

    The text is its definition, followed by those of the types of its fields, as bags store it.

    Raises:
        LinkError: the text cannot be read, lacks a definition, or has one that differs from that in the store.
    """
    rosbags = _rosbags()
    first, *others = _NEXT.split(text)
    texts = {stored_name(name): first}
    for each in others:
        called, _, definition = each.partition("\n")
        texts[stored_name(called.strip())] = definition
    found = {part: _message(rosbags, part, said, name)[part] for part, said in texts.items()}
    for part in found.keys() & store.fielddefs.keys():
        _check_same(part, found[part], store, {})
    fresh = {part: fields for part, fields in found.items() if part not in store.fielddefs}
    defaults = {
        (part, field): value for part in fresh for field, value in field_defaults(texts[part], where=name).items()
    }
    extended: Typestore = rosbags.get_typestore(rosbags.Stores.EMPTY)
    _register(rosbags, extended, {**store.fielddefs, **fresh}, {})
    _check_references(fresh, extended, {})
    return extended, defaults


def type_hash(store: Typestore, name: str) -> str:
    """Return the hash (RIHS01) of a type of ROS 2 as rosidl computes it, by its name as stores spell it.

    rosbags takes `char` for a kind of its own; rosidl writes `uint8` for it (github.com/ros2/rosidl, rosidl_adapter).
    """
    parts = _parts_of(store, name)
    if not any("char" in _kinds(store, each) for each in parts):
        return store.hash_rihs01(name)
    rosbags = _rosbags()
    plain: Typestore = rosbags.get_typestore(rosbags.Stores.EMPTY)
    fields = {each: [(field, _as_uint8(kind)) for field, kind in store.fielddefs[each][1]] for each in parts}
    plain.register({each: (store.fielddefs[each][0], fields[each]) for each in parts})
    return plain.hash_rihs01(name)


def definition_text(store: Typestore, name: str, generation: int) -> str:
    """Return the definition of a type, followed by those of the types of its fields, as bags store it.

    rosbags writes only what is spelt as a message is, and so the parts of an action are.
    """
    if "/action/" in name:
        rosbags, known = _rosbags(), store.fielddefs
        parts = {
            each: [(field, _as_message(kind)) for field, kind in known[each][1]] for each in _parts_of(store, name)
        }
        store = rosbags.get_typestore(rosbags.Stores.EMPTY)
        store.register({_of_message(each): (known[each][0], fields) for each, fields in parts.items()})
    return store.generate_msgdef(_of_message(name), ros_version=generation)[0]


def _of_message(name: str) -> str:
    return name.replace("/action/", "/msg/")


def _as_message(description: Any) -> Any:
    kind, detail = description
    return (kind, _of_message(detail)) if kind == NodeKind.TYPE else description


def _parts_of(store: Typestore, name: str) -> list[str]:
    parts = [name]
    for each in parts:  # which grows
        parts += [kind for kind in _kinds(store, each) if kind in store.fielddefs and kind not in parts]
    return parts


def _kinds(store: Typestore, name: str) -> list[str]:
    """Return the kinds of the fields of a type, or of the elements of those that are arrays."""
    described: list[Any] = [description for _, description in store.fielddefs[name][1]]
    inner = [detail[0] if kind > NodeKind.TYPE else (kind, detail) for kind, detail in described]
    return [detail if kind == NodeKind.TYPE else detail[0] for kind, detail in inner]


def _as_uint8(description: Any) -> Any:
    kind, detail = description
    if kind > NodeKind.TYPE:
        return kind, (_as_uint8(detail[0]), detail[1])
    return (kind, ("uint8", detail[1])) if kind == NodeKind.BASIC and detail[0] == "char" else description


def stored_name(name: str, kind: str = "msg") -> str:
    """Return a type's name as type stores spell it.

    Example:
        >>> stored_name("geometry_msgs/Twist"), stored_name("std_srvs/Trigger", "srv")
        ('geometry_msgs/msg/Twist', 'std_srvs/srv/Trigger')
        >>> stored_name("nav2_msgs/NavigateToPose_Goal")
        'nav2_msgs/action/NavigateToPose_Goal'
    """
    parts = name.split("/")
    if len(parts) != 2:  # noqa: PLR2004  # package and name
        return name
    return f"{parts[0]}/{'action' if is_action_part(name) else kind}/{parts[1]}"


def service_part(service_type: str, part: str) -> str:
    """Return the name of the `Request` or `Response` of a service type."""
    return f"{stored_name(service_type, 'srv')}_{part}"


def _rosbags() -> Any:
    try:
        from rosbags import typesys  # noqa: PLC0415  # an extra, needed only where types are looked up
    except ModuleNotFoundError as error:
        problem = f"message types cannot be looked up: {error.name} cannot be imported"
        raise LinkError(problem, where="robot", fix="Install it: pip install 'robot-runner[ros]'.") from error
    return typesys


def _store_of(rosbags: Any, generation: int, distro: str | None) -> Any:
    if generation == 1:
        _check_distro(distro, ROS1_DISTROS)
        return rosbags.Stores.ROS1_NOETIC
    _check_distro(distro, ROS2_DISTROS)
    return rosbags.Stores[f"ROS2_{(distro or LATEST).upper()}"]


def _check_distro(distro: str | None, known: Sequence[str]) -> None:
    if distro is not None and distro not in known:
        fix = did_you_mean(distro, known)
        raise LinkError(f"the message types of ROS distribution {distro!r} are not known", where="distro", fix=fix)


def _definitions(extra: Sequence[Path]) -> dict[str, tuple[str, str]]:
    """Return the text of each of the user's types, with its file, by name and suffix."""
    found: dict[str, tuple[str, str]] = {}
    for path in extra:
        for file in definition_files(path):
            name = f"{package_of(file)}/{file.name}"
            try:
                text = file.read_text(encoding="utf-8")
            except (OSError, UnicodeDecodeError) as error:
                fix = "Give a .msg, .srv or .action file that can be read."
                raise LinkError(f"the type definition cannot be read: {error}", where=str(file), fix=fix) from error
            where, known = found.setdefault(name, (str(file), text))
            if _words(known) != _words(text):  # as in a workspace with a copy that is older than its source
                problem = f"{name.partition('.')[0]} is defined otherwise in {where}"
                raise LinkError(problem, where=str(file), fix="Name the folder of one of them, and not of both.")
    return found


def _words(text: str) -> list[list[str]]:
    return [words for line in text.splitlines() if (words := line.partition("#")[0].split())]


def _parsed(rosbags: Any, name: str, text: str, where: str, generation: int) -> dict[str, Any]:
    parts = _parts(name, text, where, generation)
    return {name: fields for part in parts for name, fields in _message(rosbags, part, parts[part], where).items()}


def _parts(name: str, text: str, where: str, generation: int) -> dict[str, str]:
    """Return the text of each message that a definition contains, by its name as stores spell it."""
    stem, _, suffix = name.rpartition(".")
    if suffix == "msg":
        return {stored_name(stem): text}
    if suffix == "action":
        return action_parts(generation, stem, text, where=where)
    pieces = split_definition(text)
    if len(pieces) == 1:
        raise LinkError("a service has no line '---'", where=where, fix="Put '---' between request and response.")
    request, response = pieces[0], "\n---\n".join(pieces[1:])  # the parser refuses further parts
    return {service_part(stem, "Request"): request, service_part(stem, "Response"): response}


def _message(rosbags: Any, name: str, text: str, where: str) -> dict[str, Any]:
    if wide := _WIDE.search(text):
        problem = f"the field {wide[1]!r} of {name} is a wstring, which only rclpy can send"
        raise LinkError(problem, where=where, fix="Leave the file out, or reach the robot over ros2.")
    # The parser resolves names within the package only if its own is spelt with `msg`.
    spelt = name.replace("/srv/", "/msg/").replace("/action/", "/msg/")
    try:
        (fields,) = rosbags.get_types_from_msg(f"{text.strip()}\n", spelt).values()
    except rosbags.TypesysError as error:
        problem = f"the definition of {name} cannot be read: {str(error).splitlines()[-1][:120]!r}"
        raise LinkError(problem, where=where, fix="Correct the definition.") from error
    return {name: (fields[0], [(field, _of_action(kind)) for field, kind in fields[1]])}


def _register(
    rosbags: Any, store: Typestore, found: dict[str, Any], definitions: Mapping[str, tuple[str, str]]
) -> None:
    try:
        store.register(found)
    except rosbags.TypesysError as error:  # two fields of one name
        faulty = next((name for name in found if repr(name) in str(error)), "")
        where = _file_of(faulty, definitions) if faulty else "message types"
        raise LinkError(f"a definition cannot be used: {error}", where=where, fix="Correct the definition.") from error


def _of_action(kind: Any) -> Any:
    """Spell the name of a field's type as that of an action's part, where it is one: the parser knows messages only."""
    number, detail = kind
    is_part = number == NodeKind.TYPE and is_action_part(plain_type(detail))
    return (number, stored_name(plain_type(detail))) if is_part else kind


def _check_references(found: Mapping[str, Any], store: Typestore, definitions: Mapping[str, tuple[str, str]]) -> None:
    for name, (_, fields) in found.items():
        for field, (kind, detail) in fields:
            referred = detail if isinstance(detail, str) else detail[0][1] if kind > NodeKind.TYPE else None
            if isinstance(referred, str) and referred not in store.fielddefs:
                problem = f"field {field!r} of {name} is of the type {referred!r}, which is not known"
                fix = "Name the folder that defines it too." if "/msg/" in referred else "Correct the definition."
                raise LinkError(problem, where=_file_of(name, definitions), fix=fix)


def _file_of(name: str, definitions: Mapping[str, tuple[str, str]]) -> str:
    package, kind, short = name.split("/")
    stem = short if kind == "msg" else short.partition("_")[0]
    return definitions.get(f"{package}/{stem}.{kind}", (name, ""))[0]


def _check_same(name: str, fields: Any, store: Typestore, definitions: Mapping[str, tuple[str, str]]) -> None:
    known = [field for field in store.fielddefs[name][1] if field[0] != FILLER]
    if [field for field in fields[1] if field[0] != FILLER] != known:
        problem = f"{name} is defined otherwise in this distribution of ROS"
        fix = "Leave the file out, or name the distribution that it is of."
        raise LinkError(problem, where=_file_of(name, definitions), fix=fix)


# The defaults that definitions of ROS 2 give to fields, which type stores lose. Source: docs.ros.org, "Interfaces",
# "Field default value".

#: A field's type, whether it is an array, its name, and what stands behind that; constants have `=` there.
_FIELD = re.compile(r"\s*([\w/]+)(?:<=\d+)?(\[[^\]]*\])?\s+(\w+)\s+([^\s=#].*)")
_TRUTH = re.compile(r"\b(?:true|false)\b", re.IGNORECASE)
_TEXTS = ("string", "wstring")


def field_defaults(text: str, *, where: str) -> dict[str, Any]:
    r"""Return the default of each field that has one in a definition; arrays are tuples.

    Raises:
        LinkError: one cannot be read.

    Example:
        >>> field_defaults("float32 speed 0.25  # m/s\nuint8 MODE=3\nint32 count\nbool[] on [true, false]", where="a")
        {'speed': 0.25, 'on': (True, False)}
    """
    found = {}
    for line in text.splitlines():
        if (parts := _FIELD.fullmatch(line)) is not None:
            kind, array, name, written = parts.groups()
            try:
                found[name] = _default(kind, written, is_array=array is not None)
            except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError) as error:  # all of `literal_eval`
                problem = f"the default of the field {name!r} cannot be read: {written[:80]!r}"
                raise LinkError(problem, where=where, fix="Correct the definition.") from error
    return found


def _default(kind: str, written: str, *, is_array: bool) -> Any:
    if is_array:
        spelt = written if kind in _TEXTS else _TRUTH.sub(lambda word: word[0].title(), written)
        values = ast.literal_eval(spelt)  # lists are spelt as in Python, and comments, too
        if not isinstance(values, list):
            raise ValueError(f"{spelt} is not a list")
        return tuple(map(bool, values)) if kind == "bool" else tuple(values)
    if kind in _TEXTS and written[0] in "\"'":
        return ast.literal_eval(written)
    bare = written.partition("#")[0].strip()
    if kind in _TEXTS:  # quotes may be left out
        return bare
    if kind == "bool":
        return bool(("false", "true", "0", "1").index(bare.lower()) % 2)
    return float(bare) if kind.startswith("float") else int(bare)
