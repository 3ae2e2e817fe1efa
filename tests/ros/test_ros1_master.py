"""The master is asked with a deadline, and what is wrong with its address is said."""

from __future__ import annotations

import gzip
import os
import socket
import struct
import threading
import time
import xmlrpc.client
from contextlib import ExitStack, contextmanager, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from types import SimpleNamespace
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from tests.loopback_port import claim_port
from tests.processor_wait import ProcessorWait
from tests.ros.ros1_master import needs_ros1
from tests.waiting import PATIENCE

from robot_runner.core.errors import LinkError
from robot_runner.core.links.connect import link_findings
from robot_runner.ros.ros1_master import Master, master_address
from robot_runner.ros.ros1_services import call_service, service_type


@pytest.mark.parametrize(
    "uri", ["robot:11311", "http://robot", "http://:11311", "https://robot:11311", "http://robot:port", "http://[::1"]
)
def test_an_address_that_cannot_be_is_named(uri):
    with pytest.raises(LinkError) as caught:
        Master(uri)
    assert repr(uri) in caught.value.problem
    assert "ROS_MASTER_URI=http://robot:11311" in caught.value.fix


def test_the_environment_names_the_master_and_an_option_goes_before(monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://alice:11311")
    assert Master().uri == "http://alice:11311"
    assert Master("http://bob:11312").uri == "http://bob:11312"
    monkeypatch.delenv("ROS_MASTER_URI")
    assert master_address(Master().uri) == ("localhost", 11311)


def test_where_nobody_listens_there_is_no_master():
    with pytest.raises(LinkError, match="connection refused") as caught:
        Master(f"http://127.0.0.1:{claim_port()}").check()
    assert "roscore" in caught.value.fix


def test_what_named_a_master_that_is_not_there_is_what_is_to_be_corrected(monkeypatch):
    address = f"http://127.0.0.1:{claim_port()}"
    monkeypatch.setenv("ROS_MASTER_URI", address)
    with pytest.raises(LinkError) as caught:
        Master().check()
    assert (caught.value.where, caught.value.fix) == (
        "ROS_MASTER_URI",
        "Start one (roscore), or correct ROS_MASTER_URI.",
    )
    monkeypatch.setenv("ROS_MASTER_URI", "http://elsewhere:11311")
    with pytest.raises(LinkError) as caught:
        Master(address).check()
    assert caught.value.where == f"robot = 'ros1:master={address}'"
    assert "ROS_MASTER_URI" not in caught.value.fix


class _Registry(SimpleXMLRPCServer):
    """A master at which each node is registered with the same address, at which nobody listens."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), logRequests=False)
        self.uri = f"http://127.0.0.1:{claim_port()}"
        self.register_function(lambda _, node: (1, node, self.uri), "lookupNode")


def test_of_a_node_that_is_gone_the_node_is_told_and_what_befell_it():
    """It told of a master, and of a robot's name that nobody had written."""
    with _Registry() as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        with pytest.raises(LinkError) as caught:
            Master(f"http://127.0.0.1:{server.server_address[1]}", timeout=PATIENCE).pid_of("/planner")
        thread.join(PATIENCE)
    assert caught.value.problem == f"the node /planner does not answer at {server.uri}"
    assert caught.value.where == "/planner"
    assert caught.value.fix.startswith("Restart /planner")
    assert isinstance(caught.value.__cause__, ConnectionRefusedError), "of which the link learns that it is not there"


def test_a_node_of_which_nobody_can_tell_serves_no_other_one():
    assert Master(f"http://127.0.0.1:{claim_port()}").is_serving("/planner", "/cmd_vel", "/robot") is False


def test_an_unknown_host_is_named(monkeypatch):
    def unknown(*_, **__):
        raise socket.gaierror(-2, "Name or service not known")

    with pytest.raises(LinkError, match=r"'turtle\.\.lab', is not known"):
        Master("http://turtle..lab:11311").check()
    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(LinkError, match="'turtle', is not known"):
        Master("http://turtle:11311").check()


def test_a_master_that_is_silent_is_given_up_at_the_deadline():
    with socket.create_server(("127.0.0.1", 0)) as server:
        begun, wait = time.monotonic(), ProcessorWait([os.getpid()])
        with pytest.raises(LinkError, match=r"does not answer within 0\.3 s"):
            Master(f"http://127.0.0.1:{server.getsockname()[1]}", timeout=0.3).check()
        wait.look()
        assert 0.3 <= time.monotonic() - begun < 2.0 + wait.seconds


class _Endless(BaseHTTPRequestHandler):
    """Answers with a body that has no end."""

    def do_POST(self):
        self.send_response(200)
        self.end_headers()
        with suppress(OSError):
            while True:
                self.wfile.write(65536 * b" ")

    def log_message(self, *_):
        pass


class _EndlessHeader(_Endless):
    """Answers with a header that goes on byte by byte; after 20 min, its length would be refused."""

    def do_POST(self):
        self.wfile.write(b"HTTP/1.1 200 OK\r\nServer: ")
        with suppress(OSError):
            while True:
                self.wfile.write(b"x")
                time.sleep(0.02)


@pytest.mark.parametrize("endless", [_Endless, _EndlessHeader])
def test_a_master_that_answers_without_end_is_given_up_at_the_deadline(endless):
    """It filled the memory, or was awaited for ever: the deadline was that of each piece."""
    with HTTPServer(("127.0.0.1", 0), endless) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        with pytest.raises(LinkError, match=r"does not answer within 0\.1 s"):
            Master(f"http://127.0.0.1:{server.server_port}", timeout=0.1).check()
        thread.join(PATIENCE)


@contextmanager
def hardly_reading():
    """Yield a server whose connections take a few kilobytes until it reads; the rest lies in the client's system."""
    with socket.socket() as server:
        server.settimeout(PATIENCE)
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        server.bind(("127.0.0.1", 0))
        server.listen()
        yield server


def read_late(connection):
    """Read all that comes; raises a ConnectionResetError where the rest was dropped."""
    while connection.recv(65536):
        pass


def test_a_request_that_was_given_up_is_not_delivered_later():
    """What it sets would overwrite the value that is put back meanwhile."""
    with hardly_reading() as server:
        with pytest.raises(LinkError, match=r"does not answer within 0\.3 s"):
            Master(f"http://127.0.0.1:{server.getsockname()[1]}", timeout=0.3).set_parameter("/map", value=20000 * "x")
        with server.accept()[0] as connection, pytest.raises(ConnectionResetError):
            read_late(connection)


def test_a_call_of_a_service_that_was_given_up_is_not_delivered_later():
    with hardly_reading() as server, ExitStack() as leaving:

        def greet():
            connection = leaving.enter_context(server.accept()[0])
            connection.recv(65536)
            connection.sendall(struct.pack("<I", 0))  # a header without fields
            accepted.append(connection)

        accepted, kind = [], SimpleNamespace(_type="std_srvs/SetBool", _md5sum="*")
        greeting = threading.Thread(target=greet)
        greeting.start()
        request = SimpleNamespace(serialize=lambda buffer: buffer.write(20000 * b"x"))
        with pytest.raises(LinkError, match=r"0\.5 s"):
            call_service("/lamp", f"rosrpc://127.0.0.1:{server.getsockname()[1]}", kind, request, timeout=0.5)
        greeting.join(PATIENCE)
        with pytest.raises(ConnectionResetError):
            read_late(accepted[0])


def broken(_: bytes) -> None:
    raise RuntimeError("unpack requires a buffer of 4 bytes")


def test_a_response_that_is_not_valid_for_the_service_is_told():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with server.accept()[0] as connection:
                connection.recv(65536)
                connection.sendall(struct.pack("<I", 0) + b"\x01" + struct.pack("<I", 1) + b"\x01")
                connection.recv(65536)

        answering = threading.Thread(target=answer)
        answering.start()
        kind = SimpleNamespace(
            _type="std_srvs/SetBool", _md5sum="*", _response_class=lambda: SimpleNamespace(deserialize=broken)
        )
        request = SimpleNamespace(serialize=lambda buffer: buffer.write(b"\x01"))
        with pytest.raises(LinkError, match=r"not valid for std_srvs/SetBool: unpack requires") as told:
            call_service("/lamp", f"rosrpc://127.0.0.1:{server.getsockname()[1]}", kind, request, timeout=PATIENCE)
        answering.join(PATIENCE)
    assert told.value.where == "/lamp"


@pytest.mark.parametrize("uri", ["rosrpc://127.0.0.1:port", "rosrpc://[::1", "rosrpc://127.0.0.1:99999"])
def test_a_service_that_stands_at_no_address_is_told(uri):
    with pytest.raises(LinkError, match="the service cannot be reached at rosrpc"):
        service_type("/lamp", uri, timeout=1.0)


class _WebServer(BaseHTTPRequestHandler):
    def do_POST(self):
        body = b"<html>no master</html>" if self.path == "/page" else b""
        self.send_response(200 if body else 404)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.mark.parametrize("path", ["", "/page"])
def test_what_answers_as_a_web_server_is_no_master(path):
    with HTTPServer(("127.0.0.1", 0), _WebServer) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            with pytest.raises(LinkError, match="not a ROS master") as caught:
                Master(f"http://127.0.0.1:{server.server_port}{path}", timeout=5.0).check()
            assert "11311" in caught.value.fix
        finally:
            server.shutdown()
            thread.join()


class _Odd(HTTPServer):
    """Answers each request with success, and with what is none of the shape that was asked for."""

    def __init__(self, value):
        super().__init__(("127.0.0.1", 0), _OddHandler)
        self.body = xmlrpc.client.dumps(((1, "", value),), methodresponse=True).encode()


class _OddHandler(_WebServer):
    def do_POST(self):
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.server.body)))
        self.end_headers()
        self.wfile.write(self.server.body)


class _Compressed(_OddHandler):
    def end_headers(self):
        self.send_header("Content-Encoding", "gzip")
        super().end_headers()


def test_an_answer_that_was_compressed_unasked_is_not_unpacked():
    """A few bytes may become as many as fill the memory."""
    with _Odd(1) as server:
        server.RequestHandlerClass, server.body = _Compressed, gzip.compress(server.body)
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        with pytest.raises(LinkError, match="not a ROS master"):
            Master(f"http://127.0.0.1:{server.server_port}", timeout=PATIENCE).pid()
        thread.join(PATIENCE)


@pytest.mark.parametrize("value", [2.5, "/x", [], [1], [["/a", 1]], [[["/a", [1]]], [], []], {"a": 1}])
def test_an_answer_of_another_shape_is_none_of_a_master(value):
    """The run ended with a TypeError, an AttributeError, .. in place of an error."""
    with _Odd(value) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            master = Master(f"http://127.0.0.1:{server.server_port}", timeout=5.0)
            with pytest.raises(LinkError, match="not a ROS master"):
                master.state()
            with pytest.raises(LinkError):
                master.pid_of("/x")
            assert master.is_serving("/x", "/a", "/y") is False
            for ask in (master.topic_types, master.parameter_names):
                with suppress(LinkError):
                    assert all(isinstance(each, str) for each in ask())
        finally:
            server.shutdown()
            thread.join()


@needs_ros1
def test_a_real_master_says_who_does_what_and_what_is_set(master_uri):
    master = Master(master_uri)
    master.check()
    assert master.parameter("/no_such") is None
    assert master.service("/no_such") is None
    assert isinstance(master.topic_types(), dict)
    assert master.state().nodes == tuple(sorted(master.state().nodes))


@pytest.mark.long
@needs_ros1
def test_the_check_of_a_config_asks_for_the_master_and_opens_nothing(master_uri):
    assert link_findings(f"ros1:master={master_uri}") == []
    (finding,) = link_findings(f"ros1:master=http://127.0.0.1:{claim_port()}")
    assert finding.is_error
    (finding,) = link_findings("ros1:mastr=http://127.0.0.1:1")
    assert "'master'" in finding.fix
    (finding,) = link_findings("ros1:clock=wall")
    assert "clock=system" in finding.fix
