"""Secrets of the kinds that labs have, in the files where labs have them; each holds a marker of its own."""

from __future__ import annotations

import base64
import bz2
import gzip
import io
import json
import lzma
import random
import string
import tarfile
import zipfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_ALNUM = string.ascii_letters + string.digits


def marker(kind: str, length: int = 12, alphabet: str = _ALNUM) -> str:
    """Return what stands for the secret of a kind: always the same, and nothing that is written anywhere else."""
    source = random.Random(kind)  # noqa: S311 - the same each time
    text = "".join(source.choice(alphabet) for _ in range(length))
    return text if alphabet is not _ALNUM else text[:-2] + "k7"  # a digit and a letter, as most passwords have


def word(kind: str) -> str:
    """Return a marker that looks like a word of nine letters, as passwords that are easy to guess do."""
    return marker(kind, 9, string.ascii_lowercase)


def hexadecimal(kind: str, length: int = 40) -> str:
    return marker(kind, length, "0123456789abcdef")


def digits(kind: str) -> str:
    return "7" + marker(kind, 7, string.digits)


def encoded(kind: str) -> str:
    """Return `user:password` as basic authentication and Docker encode it."""
    return base64.b64encode(f"ada:{marker(kind)}".encode()).decode()


def key_lines(kind: str, count: int = 4) -> str:
    return "\n".join(marker(f"{kind} {line}", 64) for line in range(count))


@dataclass(frozen=True, slots=True)
class Planted:
    """One secret: its kind, the file it stands in, the text, and what must not be in the package."""

    kind: str
    file: str
    text: str
    marker: str


_MAKERS = {"": marker, "word": word, "hex": hexadecimal, "digits": digits, "base64": encoded}


def _of(file: str, *lines: tuple[str, str] | tuple[str, str, str]) -> Iterator[Planted]:
    """Yield what stands in a file: kinds with their texts, where § is the marker, and how that looks."""
    for kind, text, *look in lines:
        own = _MAKERS[look[0] if look else ""](kind)
        yield Planted(kind, file, text.replace("§", own), own)


def _key(kind: str, file: str, begin: str, end: str) -> Planted:
    body = key_lines(kind)
    return Planted(kind, file, f"{begin}\n{body}\n{end}".rstrip(), body.splitlines()[1])


_DASHES = "-" * 5
CONFIG = "config/small.py"
MODULE = "config/packed_paces.py"


def _python() -> Iterator[Planted]:
    yield from _of(
        CONFIG,
        ("pw", 'pw = "§"', "word"),
        ("ssh_pass", "ssh_pass = '§'", "word"),
        ("auth pair", 'auth = ("ada", "§")', "word"),
        ("annotated password", 'robot_password: str = "§"'),
        ("numeric PIN", "wifi_pin = §", "digits"),
        ("numeric password", "wifi_password2 = §", "digits"),
        ("sshpass in a list", 'uptime = ["sshpass", "-p", "§", "ssh", "pi@robot", "uptime"]', "word"),
        ("sshpass in a string", 'reboot = "sshpass -p § ssh pi@robot sudo reboot"', "word"),
        ("curl -u", 'fetch = "curl -s -u ada:§ http://robot/map"', "word"),
        ("--password in a list", 'login = ["login", "--password", "§"]', "word"),
        ("?token= in a URL", 'map_url = "http://lab.example/map?size=3&token=§"'),
        ("token@host in a URL", 'origin = "https://§@git.example.org/nav.git"', "hex"),
        ("password in an f-string's URL", 'broker = f"mqtt://lab:§@{pw}.example"', "word"),
        ("bytes", 'secret_key = b"§"'),
        ("dictionary", 'network = {"ssid": "lab", "psk": "§"}', "word"),
        ("wpa_supplicant in a string", 'supplicant = """network={\n  ssid="lab"\n  psk="§"\n}"""', "word"),
        ("comment in prose", "# The robot's password is §, ask Ada."),
        ("comment with a colon", "# pw: §", "word"),
        ("commented assignment", '# api_key = "§"'),
    )
    yield from _of(
        MODULE,
        ("environment variable set", 'os.environ["DB_PASSWORD"] = "§"', "word"),
        ("environment variable's default", 'USER_PASS = os.getenv("MQTT_PASS", "§")', "word"),
        ("default argument", 'def connect(user="ada", pw="§"): ...', "word"),
        ("MQTT client", 'def mqtt(client): client.username_pw_set("lab", "§")', "word"),
        ("paramiko", 'def log_in(ssh): ssh.connect("robot", username="pi", password="§")', "word"),
        ("basic authentication", 'def ask(get, HTTPBasicAuth): get("http://plug", HTTPBasicAuth("ada", "§"))', "word"),
        ("pexpect", 'def type_it(child):\n    child.expect("assword:")\n    child.sendline("§")', "word"),
        ("sudo -S", 'RESTART = "echo § | sudo -S systemctl restart bringup"', "word"),
        ("launch argument's default", 'def launch(Declare): return Declare("password", default_value="§")', "word"),
        ("header with a key", 'HEADERS = {"Accept": "*/*", "X-Api-Key": "§"}'),
        ("header with a basic login", 'LOGIN = {"Authorization": "Basic §"}', "base64"),
        ("Wachtwoord", 'WACHTWOORD = "§"', "word"),
        ("mail server", 'def mail(smtp): smtp.login("ada@lab.example", "§")', "word"),
        ("libpq", 'def runs(psycopg): return psycopg.connect("host=db user=ada password=§ dbname=runs")', "word"),
        ("Contraseña in Python", 'contraseña_wifi = "§"', "word"),
    )  # fmt: skip
    halves = marker("pieces of a string")
    pieces = f'API_TOKEN = (\n    "{halves[:6]}"\n    "{halves[6:]}"\n)'
    yield Planted("pieces of a string", MODULE, pieces, halves[6:])


def _yaml() -> Iterator[Planted]:
    yield from _of(
        "config/lab.yaml",
        ("MQTT password in YAML", "mqtt:\n  user: lab\n  mqtt_password: §", "word"),
        ("quoted password in YAML", 'other: {user: pi, password: "§"}', "word"),
        ("numeric pass in YAML", "robot:\n  pass: §", "digits"),
        ("netplan", "wifis:\n  wlan0:\n    access-points:\n      lab: {password: §}", "word"),
        ("Ansible", "ansible_ssh_pass: §", "word"),
        ("compose environment", "environment:\n  - POSTGRES_PASSWORD=§", "word"),
        ("parameters of a node", "bridge:\n  ros__parameters:\n    api_token: §"),
        ("contraseña in YAML", "contraseña: §", "word"),
        ("block scalar", "vault:\n  passphrase: |\n    §", "word"),
        ("comment in YAML", "# until May the token was §"),
        ("kubeconfig's token", "users:\n- name: ada\n  user:\n    token: §"),
        ("kubeconfig's key", "    client-key-data: §", "base64"),
        ("OAuth client", "client_secret: §"),
    )


def _settings() -> Iterator[Planted]:
    yield from _of(
        "config/wpa_supplicant.conf",
        ("psk of wpa_supplicant", 'network={\n  ssid="lab"\n  psk="§"\n}', "word"),
        ("wep_key0", "  wep_key0=§", "hex"),
        ("EAP identity's password", '  password="§"', "word"),
    )
    yield from _of(
        "config/lab.ini",
        ("NetworkManager", "[wifi-security]\npsk=§", "word"),
        ("hostapd", "wpa_passphrase=§", "word"),
        ("mosquitto bridge", "remote_password §", "word"),
        ("netrc", "machine data.example login ada password §", "word"),
        ("pgpass", "db.example:5432:runs:ada:§", "word"),
        ("npm token", "//registry.example/:_authToken=npm_§"),
        ("pip index", "index-url = https://ada:§@index.example/simple", "word"),
        ("AWS secret", "aws_secret_access_key = §", "hex"),
        ("WireGuard", "[Interface]\nPrivateKey = §=", "hex"),
        ("systemd", 'Environment="ROBOT_TOKEN=§"'),
        ("ODBC", "dsn = Driver=PG;Uid=lab;Pwd=§;Port=5432", "word"),
        ("rosbridge secret", "rosauth_secret=§", "word"),
    )
    yield from _of(
        "config/lab.toml", ("TOML", 'api-key = "§"'), ("TOML login", 'login = {user = "a", pw = "§"}', "word")
    )
    yield from _of(
        "config/bringup.launch",
        ("launch param", '<launch><param name="password" value="§"/></launch>', "word"),
        ("launch arg", '<arg name="mqtt_token" default="§"/>', "word"),
        ("launch env", "<env value='§' name='API_TOKEN'/>"),
        ("XML element", "<password>§</password>", "word"),
        ("XML attribute", '<wifi ssid="lab" psk="§"/>', "word"),
        ("XML comment", "<!-- password: § -->", "word"),
    )
    yield from _of("config/.pgpass", ("pgpass file", "db.example:5432:runs:ada:§", "word"))
    yield from _of("config/.env", ("dotenv file", "LAB=§"))
    yield from _of("config/docker/config.json", ("Docker login", '{"auths": {"r.example": {"auth": "§"}}}', "base64"))
    yield from _of("config/a.json", ("numeric password in JSON", '{"password": §, "n": 3}', "digits"))
    yield from _of("config/b.json", ("name and value", '[{"name": "db_password", "value": "§"}]', "word"))
    yield from _of("config/c.json", ("flags in JSON", '{"command": ["bridge", "--token", "§"]}', "word"))
    yield from _of("config/d.json", ("rosbridge auth", '{"op": "auth", "mac": "§", "client": "10.0.0.2"}', "hex"))
    service = json.dumps({"type": "service_account", "private_key": f"{_DASHES}BEGIN PRIVATE KEY{_DASHES}\n§\n"})
    yield from _of("config/e.json", ("cloud service account", service, "hex"))


LOG = "runs/r_1/log.txt"


def _log() -> Iterator[Planted]:
    # In pieces, so that no scanner takes this file's tokens for real ones.
    tokens = {
        "GitHub": "gh" + "p_" + marker("GitHub", 36),
        "GitHub fine-grained": "github_" + "pat_" + marker("GitHub fine-grained", 60),
        "GitLab": "glp" + "at-" + marker("GitLab", 20),
        "Slack": "xo" + "xb-1234567890-" + marker("Slack", 24),
        "Slack webhook": "https://hooks.slack.com/services/T01/B02/" + marker("Slack webhook", 24),
        "OpenAI": "sk-" + "proj-" + marker("OpenAI", 40),
        "Hugging Face": "h" + "f_" + marker("Hugging Face", 34),
        "Google key": "AI" + "za" + marker("Google key", 35),
        "Google OAuth": "ya" + "29." + marker("Google OAuth", 60),
        "AWS key id": "AK" + "IA" + marker("AWS key id", 16, string.ascii_uppercase),
        "PyPI": "py" + "pi-AgEIcHlwaS5vcmc" + marker("PyPI", 60),
        "SendGrid": "S" + "G." + marker("SendGrid", 22) + "." + marker("SendGrid b", 43),
        "Stripe": "sk_" + "live_" + marker("Stripe", 24),
        "Telegram": "612345678" + ":AA" + marker("Telegram", 33),
        "JWT": "ey" + "JhbGciOiJIUzI1NiJ9.eyJ" + marker("JWT", 40) + "." + marker("JWT b", 43),
        "age": "AGE-SECRET-" + "KEY-1" + marker("age", 58, string.ascii_uppercase),
    }
    for kind, token in tokens.items():
        yield Planted(kind, LOG, f"[INFO] [bridge]: connected ({token})", token[-24:])
    yield from _of(
        LOG,
        ("export", "+ export LAB_TOKEN=§"),
        ("password in a log", "password for pi: §", "word"),
        ("bearer", "> Authorization: Bearer §"),
        ("private token header", "> PRIVATE-TOKEN: §"),
        ("cookie", "> Cookie: session=§"),
        ("printed dictionary", "{'user': 'ada', 'password': '§'}", "word"),
        ("printed object", "Settings(user='ada', api_key='§', n=3)", "word"),
        ("ros2 param set", "$ ros2 param set /bridge mqtt_password §", "word"),
        ("ROS argument", "$ ros2 run bridge node --ros-args -p password:=§", "word"),
        ("mosquitto_pub -P", "$ mosquitto_pub -u lab -P § -t x -m y", "word"),
        ("mysql -p", "$ mysql -u root -p§ runs", "word"),
        ("wget", "$ wget --http-password=§ http://plug/data", "word"),
        ("nmcli", "$ nmcli device wifi connect lab password §", "word"),
        ("iwconfig", "$ iwconfig wlan0 key s:§", "word"),
        ("Redis URL", "redis://:§@cache.example:6379/0", "word"),
        ("database URL", "postgresql+psycopg://ada:§@db.example/runs", "word"),
        ("SSH fingerprint-like salted hash", "pi:$6$salt$" + "§" * 2 + ":19000:0", "hex"),
        ("quoted in JSON in a log", r'{"msg": "login {\"password\": \"§\"}"}', "word"),
        ("SAS signature", "https://x.example/blob?sv=2022&sig=§", "hex"),
        ("connection string", "DefaultEndpointsProtocol=https;AccountName=lab;AccountKey=§==", "hex"),
    )


def _keys() -> Iterator[Planted]:
    for kind in ("RSA", "EC", "OPENSSH", "ENCRYPTED"):
        begin, end = (f"{_DASHES}{word} {kind} PRIVATE KEY{_DASHES}" for word in ("BEGIN", "END"))
        yield _key(f"{kind} key", "config/notes.md", begin, end)
    pgp = [f"{_DASHES}{each} PGP PRIVATE KEY BLOCK{_DASHES}" for each in ("BEGIN", "END")]
    yield _key("PGP key", "config/notes.md", pgp[0] + "\nVersion: 1\n", pgp[1])
    ssh2 = [f"---- {each} SSH2 ENCRYPTED PRIVATE KEY ----" for each in ("BEGIN", "END")]
    yield _key("SSH2 key", "config/notes.md", *ssh2)
    vpn = [f"{_DASHES}{each} OpenVPN Static key V1{_DASHES}" for each in ("BEGIN", "END")]
    yield _key("OpenVPN key", "config/notes.md", *vpn)
    putty = "PuTTY-User-Key-File-3: ssh-ed25519\nEncryption: none\nComment: pi\nPublic-Lines: 1\nAAAA\nPrivate-Lines: 4"
    yield _key("PuTTY key", "config/putty.txt", putty, f"Private-MAC: {hexadecimal('mac')}")
    yield _key("key that was cut off", "config/cut.txt", f"{_DASHES}BEGIN RSA PRIVATE KEY{_DASHES}", "")
    yield _key("key file by its name", "config/id_ed25519", f"{_DASHES}BEGIN OPENSSH PRIVATE KEY{_DASHES}", "")


def _elsewhere() -> Iterator[Planted]:
    yield from _of("runs/r_1/Ina219/events.csv", ("token in a cell", "1.5,ok,api_token=§,3"))
    yield from _of("notes.txt", ("note", "Ada said the wifi password is §"), ("note with a dash", "pw - §", "word"))
    yield from _of("runs/r_2/PsUtil/long.txt", ("long line", "x " * 3_000_000 + "token=§ " + "y " * 100_000))


def planted() -> list[Planted]:
    """Return all secrets that stand in text."""
    return [*_python(), *_yaml(), *_settings(), *_log(), *_keys(), *_elsewhere()]


def _coded() -> Iterator[tuple[Planted, bytes]]:
    """Yield secrets whose files have no text in UTF-8, with the file's bytes."""
    for kind, file, coding in (
        ("UTF-16", "runs/r_1/windows.txt", "utf-16"),
        ("UTF-16 without a mark", "runs/r_2/windows.log", "utf-16-be"),
        ("Latin-1", "config/alt.ini", "latin-1"),
    ):
        text = f"Schlüssel für das Netz\nwifi password: {word(kind)}\nEnde\n"
        yield Planted(kind, file, text, word(kind)), text.encode(coding)
    for kind, file, press in (
        ("gzip", "runs/r_1/bridge.log.gz", gzip.compress),
        ("bzip2", "runs/r_1/bridge.log.bz2", bz2.compress),
        ("xz", "runs/r_1/bridge.log.xz", lzma.compress),
        ("zip", "runs/r_2/settings.zip", _zipped),
        ("tar", "runs/r_2/settings.tar.gz", _tarred),
        ("binary recording", "runs/r_2/recording.db3", lambda raw: b"SQLite format 3\0\1\2" + raw + b"\0" * 99),
    ):
        text = f'network={{\n  psk="{word(kind)}"\n}}\n'
        yield Planted(kind, file, text, word(kind)), press(text.encode())


def _zipped(raw: bytes) -> bytes:
    with io.BytesIO() as target:
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("etc/wpa_supplicant.conf", raw)
        return target.getvalue()


def _tarred(raw: bytes) -> bytes:
    with io.BytesIO() as target:
        with tarfile.open(fileobj=target, mode="w:gz") as archive:
            entry = tarfile.TarInfo("etc/wpa_supplicant.conf")
            entry.size = len(raw)
            archive.addfile(entry, io.BytesIO(raw))
        return target.getvalue()


def plant(folder: Path) -> list[Planted]:
    """Write all secrets into an experiment's folder, and return them."""
    found = planted()
    for each in found:
        path = folder / each.file
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{each.text}\n")
    module = folder / MODULE
    module.write_text("import os\n" + module.read_text(encoding="utf-8"), encoding="utf-8")
    for each, raw in _coded():
        (folder / each.file).parent.mkdir(parents=True, exist_ok=True)
        (folder / each.file).write_bytes(raw)
        found.append(each)
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    setting = Planted("--set", "manifest.json", "", word("--set"))
    for execution in (manifest, *manifest["executions"]):
        execution["deviations"]["db_pass"] = setting.marker
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    note = Planted("note in the journal", "journal.jsonl", "", word("note in the journal"))
    with (folder / "journal.jsonl").open("a", encoding="utf-8") as journal:
        record = {"kind": "note", "at": "2026-01-01T00:00:00.000Z", "text": f"pw of the robot: {note.marker}"}
        journal.write(json.dumps(record, separators=(",", ":")) + "\n")
    return [*found, setting, note]
