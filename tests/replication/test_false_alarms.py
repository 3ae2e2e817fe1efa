"""What only looks like a secret stays: in our examples and pages, and in what configs of robots are full of."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robot_runner.replication.named_secrets import Grammar
from robot_runner.replication.redaction import HOME_PATH, Redactor, grammar_of

ROOT = Path(__file__).parents[2]

#: Each a line of a config, and each of a kind that a scanner for secrets is known to take for one.
LOOK_ALIKES = """\
password = os.environ["PLUG_PASSWORD"]
password = getpass.getpass("Password: ")
token = args.token or read_token(path)
token: str | None = None
api_key: str = ""
auth_method = "digest"
password_file = "~/.mqtt"
password_env = "PLUG_PASSWORD"
secret_name = "mqtt-login"
eos_token = "</s>"
max_tokens = 4096
tokens = prompt.split()
data_columns = ["tokens", "token_latency", "pass_rate"]
factors = [Factor("Token budget", [128, 256]), Factor("Key", ["C", "D"])]
first_pass = "warm-up"
low_pass = LowPass("butterworth", 20.0)
if key == "password": raise KeyError("password")
author = "Ada Lovelace"; authors = ["Grace Hopper"]
keyboard_layout = "us-international"
led_pin = 17; trigger_pin = 2345
topic_key = "odometry/filtered"
commit = "9f40ae4c31e4a74a91f0d2fca292492555d0c1e2"
sha256 = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
identifier = "123e4567-e89b-12d3-a456-426614174000"
image = "ros@sha256:e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
mac_address = "b8:27:eb:69:51:f0"
url = "https://doi.org/10.1109/ICSE-Companion52605.2021.00029"
origin = "git@github.com:S2-group/robot-runner.git"
robot = "ssh://pi@192.168.0.12:22"
page = "https://lab.example/map?key=floor&size=3"
parser.add_argument("--token", help="where the token is kept")
parser.add_argument("--password", "-p", default=None)
# The password is read from the environment, the token is optional, and the key is pressed.
# pass: nothing to do here
\"\"\"Args: password: the password of the broker. token: see there.\"\"\"
assert token is not None, "the token is missing"
print(f"token {token} of {user}")
cookie_cutter = "square"
os.environ.setdefault("ROS_DOMAIN_ID", "42")
encryption = "wpa-psk"; key_mgmt = "WPA-PSK"
secrets = load_secrets()
credentials = None
connect(password=password, token=self.token, auth=auth)
wait_for("password:", timeout=5)
session = requests.Session(); session.auth = (user, password)
authentication = True
bypass_token_check = True
compass = "magnetometer"; passenger_count = 3
encoder_key = hashlib.sha256(name.encode()).hexdigest()
ssh_key = Path("~/.ssh/id_ed25519")
"""


def _configs():
    """Yield names and texts: the examples, the code of the pages, and 50 configs with one look-alike each."""
    for path in sorted((ROOT / "examples").rglob("*.py")):
        yield path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "docs").glob("*.md")):
        for number, block in enumerate(re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)):
            yield f"{path.name} {number}", block
    for number, line in enumerate(LOOK_ALIKES.splitlines()):
        yield f"look-alike {number}: {line}", f"{line}\n"


def test_hardly_anything_is_taken_for_a_secret(record_property):
    redactor, alarms, count = Redactor.knowing((), home=None), [], 0
    for name, text in _configs():
        count += 1
        found = redactor.find(text.encode(), Grammar.CODE, is_file=True)
        alarms += [(name, each.what, text.encode()[each.start : each.end]) for each in found if each.what != HOME_PATH]
    record_property("figure", f"secrets: {len(alarms)} false alarms on {count} configs without any")
    assert count > 150
    assert len(alarms) <= 3, alarms  # one config in fifty


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.yaml", "permissions:\n  id-token: write\npassword: ${DB_PASSWORD}\ntoken: null\ntokens: 128\nauth: none\n"),
        ("a.csv", "time_s,tokens,pass,key\n0.1,12,1,3\n"),
        ("a.json", '{"password": null, "token": {"from": "env"}, "max_tokens": 4096, "auth": false, "base-passwd": "3.6.1"}'),
        ("log.txt", "[INFO] token accepted\nno password needed\npassword: \npass: 12\nkey: pressed\nauthor: Ada\n"),
        (
            "a.sh",
            'PASSWORD="$1"\ncurl -u "$USER:$PW" x\nsshpass -e ssh x\nread -s -p "Password: " pw\nTOKEN=$(cat t)\n',
        ),
        ("a.xml", '<param name="max_tokens" value="128"/><arg name="password" default="$(env PW)"/>'),
    ],
)
def test_settings_without_secrets_stay_as_they_are(name, text):
    redactor = Redactor.knowing((), home=None)
    found = redactor.find(text.encode(), grammar_of(Path(name)), is_file=True)
    assert [text.encode()[each.start : each.end] for each in found] == []
