"""Threads that take the samples of a participant's readers and call their handlers."""

from __future__ import annotations

import logging
import threading
import time
import types
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

from cyclonedds.builtin import BuiltinDataReader
from cyclonedds.core import DDSException, GuardCondition, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.idl import IdlStruct
from cyclonedds.idl import types as idl

from robot_runner.core.errors import LinkError
from robot_runner.core.events.early_end import raised_in_thread
from robot_runner.ros.action_types import is_action_part
from robot_runner.ros.message_codec import FILLER
from robot_runner.ros.qos_policies import KEPT
from robot_runner.ros.shapes import Field, Shape

if TYPE_CHECKING:
    from cyclonedds.domain import DomainParticipant

_logger = logging.getLogger(__name__)

# The DDS types of messages are made at run time; their samples go through as the bytes that they are on the wire.

WireType = type[Any]

#: CDR begins with two bytes for the encoding and two for options.
HEADER_BYTES = 4

_PRIMITIVES: dict[str, Any] = {
    "bool": bool,
    "byte": idl.byte,
    "char": idl.uint8,  # ROS 2 means an unsigned octet by it
    "string": str,
    "wstring": str,
    "float32": idl.float32,
    "float64": idl.float64,
    **{f"{sign}int{bits}": getattr(idl, f"{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)},
}

# They are indexed like generic types, but are not typed as such.
_ARRAY: Any = idl.array
_SEQUENCE: Any = idl.sequence
_BOUNDED_STRING: Any = idl.bounded_str

#: The header of rmw_cyclonedds before requests and replies: the client's GUID, and the number of its request.
_SERVICE_HEADER = {"guid": idl.uint64, "seq": idl.int64}


@dataclass(slots=True, eq=False)
class RawSample:
    """The bytes of a sample, CDR with its header of four bytes, and its sample info, which the reader sets."""

    data: bytes
    sample_info: Any = None


def wire_type_name(message_type: str, kind: str = "msg") -> str:
    """Return the DDS type of a ROS type.

    Example:
        >>> wire_type_name("geometry_msgs/Twist"), wire_type_name("std_srvs/Trigger_Request", "srv")
        ('geometry_msgs::msg::dds_::Twist_', 'std_srvs::srv::dds_::Trigger_Request_')
        >>> wire_type_name("nav2_msgs/NavigateToPose_SendGoal_Request", "srv")
        'nav2_msgs::action::dds_::NavigateToPose_SendGoal_Request_'
    """
    package, _, name = message_type.partition("/")
    return f"{package}::{'action' if is_action_part(message_type) else kind}::dds_::{name}_"


@lru_cache(maxsize=512)
def topic_wire_type(shape: Shape) -> WireType:
    """Return the DDS type of a message type; its instances are made of a sample's bytes."""
    return _structure(shape, wire_type_name(shape.type_name), {})


@lru_cache(maxsize=256)
def service_wire_type(shape: Shape, *, has_header: bool = True) -> WireType:
    """Return the DDS type of a request or response; without a header for a middleware that has none."""
    return _structure(shape, wire_type_name(shape.type_name, "srv"), _SERVICE_HEADER if has_header else {})


def _structure(shape: Shape, type_name: str, leading: dict[str, Any]) -> WireType:
    members = leading | {field.name: _member(field) for field in shape.fields}
    if not shape.fields:
        members[FILLER] = idl.uint8

    def body(namespace: dict[str, Any]) -> None:
        namespace["__annotations__"].update(members)
        # The bytes come from a compiled serialiser of the type catalogue. That of cyclonedds, which walks the type for
        # each sample, is several times slower, and would decode samples that are recorded as bytes.
        namespace["__init__"] = _keep
        namespace["serialize"] = _bytes_of
        namespace["deserialize"] = staticmethod(RawSample)
        namespace["deserialize_key"] = staticmethod(RawSample)

    name = type_name.rpartition("::")[2]
    return types.new_class(name, (IdlStruct,), {"typename": type_name.replace("::", ".")}, body)


def _keep(self: Any, data: bytes) -> None:
    self.data = data


def _bytes_of(self: Any, **_: Any) -> bytes:
    data: bytes = self.data
    return data


def _member(field: Field) -> Any:
    one: Any = _one(field)
    if field.count is None:
        return one
    if isinstance(field.count, int):
        return _ARRAY[one, field.count]
    return _SEQUENCE[one] if field.count.limit is None else _SEQUENCE[one, field.count.limit]


def _one(field: Field) -> Any:
    if isinstance(field.kind, Shape):
        return topic_wire_type(field.kind)
    if field.limit is not None:
        return _BOUNDED_STRING[field.limit]
    return _PRIMITIVES[field.kind]


_ANY = ViewState.Any | InstanceState.Any | SampleState.Any

#: How many samples are taken at once; the rest are taken in the next turn.
_BATCH = 256

#: The thread checks at least this often whether to end, ns.
_TURN_NS = 1_000_000_000

_END_SECONDS = 5.0

#: A wait checks its condition at least this often, s: DDS announces a discovered endpoint before it matches it, and
#: does not announce the match.
_LOOK = 0.05

#: Held wherever cyclonedds makes a QoS of what was discovered: it does so in variables that all threads of a process
#: share (cyclonedds/qos.py, `_gc_…`), so that two links at once read the QoS and user data of each other's endpoints.
READING_QOS = threading.Lock()

#: After this many failures to take samples, one after the other, a reader is broken.
_MOST_FAULTS = 100


def delete(entity: Any) -> None:
    """Delete a DDS entity now, and not when its last reference goes."""
    entity.__del__()  # cyclonedds has no other way; called again later, it does nothing


class Source:
    """A reader whose samples are handed to `handler`, one by one.

    Where it keeps `depth` samples at most, the run fails once that many have waited: it may have dropped some.
    """

    def __init__(self, reader: Any, handler: Callable[[Any], None], where: str, *, depth: int = 0) -> None:
        self.reader = reader
        self.handler = handler
        self.where = where
        self.depth = depth
        self._is_overrun = False
        self.condition = ReadCondition(reader, _ANY)
        self.is_open = True
        self.is_busy = False
        self.afterwards: Callable[[], None] | None = None
        self.faults = 0

    def note_overrun(self) -> None:
        """Fail the run, once; samples go on, as the robot of a simulation outlives a pause of its process."""
        if not self._is_overrun:
            self._is_overrun = True
            problem = f"callbacks are too slow: {self.depth:,} messages waited for them, and more may be lost"
            fix = "Have them return sooner, or do their work after the mission, on a bag of it (RosBag)."
            error = LinkError(problem, where=self.where, fix=fix)
            if not raised_in_thread(error, f"the callback of {self.where}"):
                _logger.error("%s", error)


class Reception:
    """Readers of a participant, served by one thread of their own: the topics of a lane, or services and the graph.

    It uses a wait set rather than listeners: these are called in the receiving threads, where a slow callback would
    delay everything that arrives.
    """

    def __init__(self, participant: DomainParticipant) -> None:
        self._waitset = WaitSet(participant)
        self._guard = GuardCondition(participant)
        self._waitset.attach(self._guard)
        self._sources: tuple[Source, ...] = ()
        self._lock = threading.Lock()
        self._turned = threading.Condition()
        self._is_closed = False
        self._is_woken = False
        self._asked: deque[Callable[[], None]] = deque()
        self._thread = threading.Thread(target=self._serve, name="dds reception", daemon=True)

    @property
    def is_served_here(self) -> bool:
        """Whether this is the thread that serves, as in a callback."""
        return threading.current_thread() is self._thread

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def add(self, reader: Any, handler: Callable[[Any], None], where: str) -> Source:
        """Have each sample of the reader handed to `handler`, in this thread of its own; `where` is for the log."""
        source = Source(reader, handler, where)
        self.serve(source)
        return source

    def serve(self, source: Source) -> None:
        """Begin to hand samples to the handler; the first one may be handled before this returns."""
        with self._lock:
            # The latest first: those of the graph, which are added before all others, can wait.
            self._sources = (source, *self._sources)
            self._waitset.attach(source.condition)

    def remove(self, source: Source) -> None:
        """Stop serving a reader, and delete it."""
        with self._lock:
            if not source.is_open:
                return
            source.is_open = False
            if source in self._sources:  # it may never have been served
                self._sources = tuple(each for each in self._sources if each is not source)
                self._waitset.detach(source.condition)
            delete(source.condition)
            delete(source.reader)

    def drain(self, source: Source) -> None:
        """Handle what a reader has received by now; call it in the thread that serves, before the reader is removed."""
        self._take(source, KEPT)

    def when_idle(self, source: Source, act: Callable[[], None]) -> None:
        """Call `act` in the thread that serves, as soon as the source's handler has returned."""
        if not self.is_served_here:
            self._asked.append(partial(self._do, source, partial(self.when_idle, source, act)))
            self.wake()
        elif source.is_busy:
            source.afterwards = act
        else:
            act()

    def wait_for(self, is_so: Callable[[], bool], timeout: float) -> bool:
        """Wait until `is_so` holds, which is checked after samples were received; `timeout` is in seconds.

        A callback may wait, too: samples are then served within it.
        """
        if self.is_served_here:
            return self._turn_until(is_so, timeout)
        deadline = time.monotonic() + timeout
        with self._turned:
            while not is_so() and not self._is_closed:
                left = deadline - time.monotonic()
                if left <= 0:
                    return False
                self._turned.wait(min(left, _LOOK))
        return is_so()

    def wake(self) -> None:
        """Have all waits check their conditions again, which may hold for another reason than a sample."""
        self._guard.set(True)
        self._is_woken = True  # afterwards: the turn that sees it takes the guard back

    def wait_event(self, event: threading.Event, timeout: float) -> None:
        """Wait for an event that any thread may set; otherwise like `wait_for`."""
        if self.is_served_here:
            self._turn_until(event.is_set, timeout)
        else:
            event.wait(timeout)

    def close(self) -> None:
        """End the thread; closing twice does nothing."""
        if self._is_closed:
            return
        self._is_closed = True
        self._guard.set(True)
        with self._turned:
            self._turned.notify_all()
        if self._thread.is_alive() and not self.is_served_here:
            self._thread.join(_END_SECONDS)

    def _serve(self) -> None:
        while not self._is_closed:
            self._turn(_TURN_NS)

    def _turn_until(self, is_so: Callable[[], bool], timeout: float) -> bool:
        deadline = time.monotonic() + timeout
        with self._without_busy():
            while not is_so() and not self._is_closed:
                left = deadline - time.monotonic()
                if left <= 0:
                    return False
                self._turn(int(min(left, _LOOK) * 1e9))
        return is_so()

    @contextmanager
    def _without_busy(self) -> Iterator[None]:
        """Leave out the sources whose callbacks have not returned: they are not called again before that."""
        busy = [source for source in self._sources if source.is_busy]
        with self._lock:
            for source in busy:
                self._waitset.detach(source.condition)
        try:
            yield
        finally:
            with self._lock:
                for source in busy:
                    if source.is_open:
                        self._waitset.attach(source.condition)

    def _turn(self, timeout_ns: int) -> None:
        if not self._waitset.wait(timeout_ns):
            return
        if self._is_woken and not self._is_closed:
            self._is_woken = False
            self._guard.set(False)
        while self._asked:
            self._asked.popleft()()
        for source in self._sources:
            if not source.is_busy:
                self._take(source)
        with self._turned:
            self._turned.notify_all()

    def _take(self, source: Source, most: int = _BATCH) -> None:
        if not isinstance(source.reader, BuiltinDataReader):
            self._take_at_once(source, most)
            return
        # cyclonedds cannot always make an object of what is announced, and loses all that it takes with it.
        while most and source.is_open and self._take_at_once(source, 1):
            most -= 1

    def _take_at_once(self, source: Source, most: int) -> bool:
        """Handle samples, and return whether there were any."""
        is_discovery = isinstance(source.reader, BuiltinDataReader)
        try:
            with READING_QOS if is_discovery else nullcontext():
                samples = source.reader.take(max(most, source.depth))
        except DDSException:
            if source.is_open and not self._is_closed:  # a callback may close the link
                raise
            return False
        except Exception:
            source.faults += 1
            if source.faults > _MOST_FAULTS:
                raise
            _logger.exception("a sample of %s cannot be read", source.where)
            return True
        source.faults = 0
        if 0 < source.depth <= len(samples):
            source.note_overrun()
        had_any = bool(samples)
        source.is_busy = True
        samples.reverse()
        while samples and source.is_open:  # each is forgotten once it was handled
            self._do(source, partial(source.handler, samples.pop()))
        source.is_busy = False
        if source.afterwards is not None:
            act, source.afterwards = source.afterwards, None
            self._do(source, act)
        return had_any

    def _do(self, source: Source, act: Callable[[], None]) -> None:
        try:
            act()
        except Exception:  # one bad sample, such as of another version of a type, must not end the thread for all
            _logger.exception("a sample of %s could not be used", source.where)
