"""A rosbridge behind TLS is one that has proved who it is, and learns who we are; every refusal says what to do."""

from __future__ import annotations

import base64
import datetime as dt
import ipaddress
import os
import socket
import ssl
import time
from contextlib import closing

import pytest
from tests.conftest import HEAD
from tests.processor_wait import ProcessorWait

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.connect import link_findings
from robot_runner.ros import rosbridge_session
from robot_runner.ros.link_opening import open_rosbridge_link
from robot_runner.testing import RosbridgeServer

x509 = pytest.importorskip("cryptography.x509")
from cryptography.hazmat.primitives import hashes, serialization  # noqa: E402 - after the skip
from cryptography.hazmat.primitives.asymmetric import ec  # noqa: E402

SECRET = "0123456789abcdef"  # noqa: S105 - of the server of these tests
PASSWORD = "open sesame, twice"  # noqa: S105 - likewise
NOW = dt.datetime.now(dt.UTC)
DAY = dt.timedelta(days=1)


class Authority:
    """Signs certificates, into files of a folder."""

    def __init__(self, folder):
        self.folder = folder
        self.key = ec.generate_private_key(ec.SECP256R1())
        self.name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "lab")])
        self.ca = folder / "ca.pem"
        basic = x509.BasicConstraints(ca=True, path_length=None)
        self.ca.write_bytes(self._signed(self.name, self.key, [basic], NOW + DAY))

    def certificate(self, name, *hosts, until=NOW + DAY, own=False):
        """Write NAME.pem, which has the key, too; one of its own (`own`) is signed by itself."""
        key = ec.generate_private_key(ec.SECP256R1())
        subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
        names = [
            x509.IPAddress(ipaddress.ip_address(each)) if each[0].isdigit() else x509.DNSName(each) for each in hosts
        ]
        pem = self._signed(subject, key, [x509.SubjectAlternativeName(names)], until, own=own)
        secret = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        path = self.folder / f"{name}.pem"
        path.write_bytes(pem + secret)
        return path

    def _signed(self, subject, key, extensions, until, *, own=False):
        builder = x509.CertificateBuilder().subject_name(subject).issuer_name(subject if own else self.name)
        builder = builder.public_key(key.public_key()).serial_number(x509.random_serial_number())
        builder = builder.not_valid_before(NOW - 3 * DAY).not_valid_after(until)
        for extension in extensions:
            builder = builder.add_extension(extension, critical=False)
        return builder.sign(key if own else self.key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    return Authority(tmp_path_factory.mktemp("lab"))


def server_context(certificate, *, clients=None):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    if clients is not None:
        context.verify_mode = ssl.CERT_REQUIRED
        context.load_verify_locations(clients)
    return context


def served(certificate=None, *, clients=None, **options):
    tls = None if certificate is None else server_context(certificate, clients=clients)
    return closing(RosbridgeServer(tls=tls, **options))


def works(url):
    with closing(open_rosbridge_link(url, SystemClock())) as link:
        return link.call("/lamp", "std_srvs/Trigger")["success"]


def refusal(url):
    """Return the error that a link to this address is, in time."""
    begun, wait = time.monotonic(), ProcessorWait([os.getpid()])
    with pytest.raises(LinkError) as caught:
        open_rosbridge_link(url, SystemClock())
    wait.look()
    assert time.monotonic() - begun - wait.seconds < 8.0
    assert caught.value.fix
    return str(caught.value)


@pytest.mark.long
def test_a_server_that_proves_who_it_is_is_reached_and_no_other(lab):
    good = lab.certificate("robot", "127.0.0.1")
    fingerprint = x509.load_pem_x509_certificate(good.read_bytes()).fingerprint(hashes.SHA256()).hex(":").upper()
    with served(good) as server:
        server.offer("/lamp", "std_srvs/Trigger", lambda _: {"success": True})
        assert works(f"{server.url}?ca={lab.ca}")
        assert works(f"wss://127.0.0.1:{server.port}?fingerprint={fingerprint}")
        assert "is not trusted" in refusal(server.url)
        assert "another fingerprint" in refusal(f"{server.url}?fingerprint={'ab' * 32}")
        assert "not one of 'localhost'" in refusal(f"rosbridge+tls://localhost:{server.port}?ca={lab.ca}")
        told = refusal(f"rosbridge://127.0.0.1:{server.port}")
        assert "the server speaks TLS" in told
        assert f"rosbridge+tls://127.0.0.1:{server.port}" in told
    with served(lab.certificate("old", "127.0.0.1", until=NOW - DAY)) as server:
        assert "has expired" in refusal(f"{server.url}?ca={lab.ca}")
    own = lab.certificate("own", "127.0.0.1", own=True)
    with served(own) as server:
        told = refusal(f"{server.url}?ca={lab.ca}")
        assert "not trusted: self-signed" in told
        assert "fingerprint=" in told
        server.offer("/lamp", "std_srvs/Trigger", lambda _: {"success": True})
        assert works(f"{server.url}?ca={own}")


def test_over_tls_one_thread_at_a_time_is_in_openssl(lab, monkeypatch):
    """It has one state for who reads and who writes, and does not lock it: one first request in 30 was lost."""
    inside, at_once = set(), []

    def counted(kind, act):
        def enter(connection, *given):
            if connection.server_side:
                return act(connection, *given)
            at_once.append([*inside, kind])
            inside.add(kind)
            try:
                return act(connection, *given)
            finally:
                inside.discard(kind)

        return enter

    for kind in ("read", "send"):
        monkeypatch.setattr(ssl.SSLSocket, kind, counted(kind, getattr(ssl.SSLSocket, kind)))
    with served(lab.certificate("robot", "127.0.0.1")) as server:
        server.offer("/lamp", "std_srvs/Trigger", lambda _: {"success": True})
        assert all(works(f"{server.url}?ca={lab.ca}") for _ in range(5))
    assert {kind for kinds in at_once for kind in kinds} == {"read", "send"}
    assert max(map(len, at_once)) == 1


def test_a_server_without_tls_behind_an_address_of_tls_is_said(lab, monkeypatch):
    with served() as server:
        assert "no TLS connection can be made there" in refusal(f"rosbridge+tls://127.0.0.1:{server.port}?ca={lab.ca}")
    monkeypatch.setattr(rosbridge_session, "ANSWER", 1.0)
    with closing(socket.create_server(("127.0.0.1", 0))) as silent:  # takes connections and says nothing
        told = refusal(f"rosbridge+tls://127.0.0.1:{silent.getsockname()[1]}?ca={lab.ca}")
    assert "does not answer as TLS within 1 s" in told


def test_a_server_that_asks_for_our_certificate_gets_it(lab):
    robot, me = lab.certificate("robot", "127.0.0.1"), lab.certificate("me", "me.lab")
    with served(robot, clients=lab.ca) as server:
        server.offer("/lamp", "std_srvs/Trigger", lambda _: {"success": True})
        assert works(f"{server.url}?ca={lab.ca}&cert={me}")
        assert "one does that asks for a certificate and none is given" in refusal(f"{server.url}?ca={lab.ca}")
        other = f"{server.url}?ca={lab.ca}&cert={lab.certificate('other', 'other.lab', own=True)}"
        assert "asks for a certificate and refuses ours" in refusal(other)


@pytest.mark.parametrize(
    ("query", "header"),
    [
        ("user=ann&password_env=ROBOT_PASSWORD", "Basic " + base64.b64encode(f"ann:{PASSWORD}".encode()).decode()),
        ("token_file={file}", f"Bearer {PASSWORD}"),
    ],
    ids=["password", "token"],
)
def test_credentials_of_a_proxy_come_from_the_environment_or_a_file(query, header, lab, monkeypatch, tmp_path):
    (tmp_path / "token").write_text(f"{PASSWORD}\n")
    query = f"?ca={lab.ca}&{query.format(file=tmp_path / 'token')}"
    with served(lab.certificate("robot", "127.0.0.1"), authorization=header) as server:
        server.offer("/lamp", "std_srvs/Trigger", lambda _: {"success": True})
        monkeypatch.setenv("ROBOT_PASSWORD", PASSWORD)
        assert link_findings(server.url + query) == []
        assert works(server.url + query)
        assert "asks for credentials (HTTP 401)" in refusal(f"{server.url}?ca={lab.ca}")
        monkeypatch.setenv("ROBOT_PASSWORD", "another one")
        (tmp_path / "token").write_text("another one")
        told = refusal(server.url + query)
        assert "refuses our credentials (HTTP 401)" in told
        assert "another one" not in told


def test_rosauth_is_satisfied_by_the_secret_and_refuses_without(monkeypatch):
    monkeypatch.setenv("ROSAUTH_SECRET", SECRET)
    with served(secret=SECRET) as server:
        server.offer("/lamp", "std_srvs/Trigger", lambda _: {"success": True})
        assert works(f"{server.url}?rosauth_env=ROSAUTH_SECRET")
        told = refusal(server.url)
        assert "connection is lost" in told
        assert "?rosauth_env=" in told
        monkeypatch.setenv("ROSAUTH_SECRET", SECRET[::-1])
        told = refusal(f"{server.url}?rosauth_env=ROSAUTH_SECRET")
        assert "does not take our authentication by rosauth" in told
        assert SECRET[::-1] not in told
        monkeypatch.setenv("ROSAUTH_SECRET", "short")
        assert "has 5 characters" in refusal(f"{server.url}?rosauth_env=ROSAUTH_SECRET")


@pytest.mark.parametrize(
    ("address", "problem"),
    [
        ("rosbridge+tls://robot?ca=/no/such.pem", "/no/such.pem cannot be used: No such file"),
        ("rosbridge+tls://robot?fingerprint=abc", "3 characters of hexadecimal, not 64"),
        ("rosbridge://robot?ca=lab.pem", "ca is given, and the address is not one of TLS"),
        ("rosbridge+tls://robot?user=ann", "user, password and token do not go together"),
        ("rosbridge+tls://robot?token_env=NO_SUCH", "the variable NO_SUCH is not set"),
        ("rosbridge+tls://robot?token_file=/no/such", "the secret in /no/such cannot be read"),
        ("rosbridge+tls://robot?tokn_env=X", "Did you mean 'token_env'?"),
        ("rosbridge://robot?token_env=HOME", "for everybody to read"),
        ("rosbridge+tls://ann:swordfish@robot", "has a user or a password in it, which would be recorded"),
    ],
)
def test_what_an_address_cannot_say_is_a_finding_that_shows_no_secret(address, problem):
    (finding,) = link_findings(address)
    assert finding.is_error
    assert problem in str(finding)
    assert "swordfish" not in str(finding)


def test_over_tls_nothing_is_said_of_who_could_read_it(lab):
    assert link_findings(f"rosbridge+tls://robot.lab:9090?ca={lab.ca}") == []
    assert link_findings(f"wss://robot.lab?ca={lab.ca}") == []


@pytest.mark.long
def test_a_run_reaches_its_robot_by_tls_and_nothing_of_the_secret_is_recorded(
    lab, write_config, robot_runner, tmp_path
):
    secret = tmp_path / "lab_token"
    secret.write_text(PASSWORD)
    body = """
        def launch_mission(self, context):
            link = connect_robot(context)
            print("lamp:", link.call("/lamp", "std_srvs/Trigger")["message"])
    """
    table = "    def create_run_table(self):\n        return RunTableModel([Factor('Task', ['Video', 'Network'])])\n"
    head = HEAD.replace("import *", "import *\nfrom robot_runner.plugins import connect_robot", 1)
    config = write_config(body, table=table, head=head)
    with served(lab.certificate("robot", "127.0.0.1"), authorization=f"Bearer {PASSWORD}") as server:
        server.offer("/lamp", "std_srvs/Trigger", lambda _: {"success": True, "message": "it is on"})
        server.publish("/odom", "nav_msgs/Odometry", {})
        answer = robot_runner(config, "--set", f"robot={server.url}?ca={lab.ca}&token_file={secret}")
    assert answer.code == 0, answer.out + answer.err
    kept = [path.read_bytes() for path in (tmp_path / "results").rglob("*") if path.is_file()]
    assert any(b"lamp: it is on" in data for data in kept)
    assert not any(PASSWORD.encode() in data for data in kept)
    assert PASSWORD not in answer.out + answer.err
