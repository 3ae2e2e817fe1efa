"""Secrets are found in whatever form they are written, and what only looks like one stays."""

from __future__ import annotations

import csv
import io
from collections import Counter
from pathlib import Path

import pytest

from robot_runner.replication.code_secrets import secrets_in_code
from robot_runner.replication.named_secrets import Grammar
from robot_runner.replication.redaction import Hits, Redactor, chunks_of, grammar_of, is_binary


def _clean(text, *, loose=True, secrets=(), home=None):
    return (
        Redactor.knowing(secrets, home=home).redacted(text.encode(), Grammar.TEXT if loose else Grammar.MARKUP).decode()
    )


@pytest.mark.parametrize(
    ("text", "cleaned"),
    [
        ('{"password": "hunter2", "n": 3}', '{"password": "REDACTED", "n": 3}'),
        (r'{"password": "a\"b", "n": 3}', '{"password": "REDACTED", "n": 3}'),
        (r'{"said": "{\"password\": \"hunter2\", \"n\": 3}"}', r'{"said": "{\"password\": \"REDACTED\", \"n\": 3}"}'),
        (r'{"said": "{\"password\": \"a\\\"b\", \"n\": 3}"}', r'{"said": "{\"password\": \"REDACTED\", \"n\": 3}"}'),
        (r'{"fields":"{\"api_key\": \"abc\"}"}', r'{"fields":"{\"api_key\": \"REDACTED\"}"}'),
        ('password = "1234"', 'password = "REDACTED"'),
        ("connect(token='xyz', user='ada')", "connect(token='REDACTED', user='ada')"),
        ("https://ada:lovelace@lab.example/x", "https://ada:REDACTED@lab.example/x"),
        ("Authorization: Bearer abcdefghijklmnop", "Authorization: Bearer REDACTED"),
        ("key ghp_abcdefghijklmnopqrstuvwxyz012345", "key REDACTED"),
        ("pi ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIabc ada@pi", "pi ssh-ed25519 REDACTED ada@pi"),
        ("SHA256:" + "aB3/" * 10 + "xyz", "SHA256:REDACTED"),
        ("pi:$6$rounds=5000$salt$" + "aB3/" * 21 + ":19000", "pi:$6$REDACTED:19000"),
        ("wifi $2b$12$" + "aB3/" * 13 + "x", "wifi $2b$REDACTED"),
        ("$argon2id$v=19$m=65536,t=3,p=4$c29tZXNhbHQ$" + "aB3/" * 10 + "abc", "$argon2id$REDACTED"),
        ("sshpass --password hunter2 pi", "sshpass --password REDACTED pi"),
        ("opened /home/ada/maps/lab.pgm", "opened ~/maps/lab.pgm"),
        ("file:///Users/ada/lab", "file://~/lab"),
        ("opened /mnt/c/Users/ada/maps/lab.pgm", "opened ~/maps/lab.pgm"),  # Windows' home, in its Linux
        ("cwd=/ro" + "ot/study", "cwd=~/study"),
    ],
)
def test_a_secret_is_replaced(text, cleaned):
    assert _clean(text, loose=False) == cleaned


@pytest.mark.filterwarnings("error")
def test_a_secret_is_found_in_code_that_is_no_utf_8():
    code = "# Größe\npassword = 'hunter2'\n".encode("latin-1")
    found = Redactor.knowing((), home=None).find(code, Grammar.CODE, is_file=True)
    assert [code[each.start : each.end] for each in found] == [b"hunter2"]


def test_a_secret_is_found_in_code_that_python_warns_of():
    assert secrets_in_code("pattern = '\\d+'\npassword = 'tr0ub4dor'\n") == {"tr0ub4dor"}


@pytest.mark.parametrize(
    "text",
    [
        "time_s,power_W\n0.1,7.5\n",
        'getpass("Password: ") or ask("again")',
        "password = os.environ['WIFI_PASSWORD']",
        "def connect(password: str) -> None: ...",
        "tokens = tokenize(text)",
        "/mnt/home/data /opt/root/x /rootfs/x",
        '{"hash": "sha256:' + "ab" * 32 + '"}',
        "~/already/short",
    ],
)
def test_what_is_no_secret_stays(text):
    assert _clean(text, loose=False) == text


def test_bytes_of_pictures_and_samples_are_no_hashes_of_passwords():
    of_a_figure = b"$1$\x8e\xc4\x93D\xd2\x8d\xa4\x92\xee\xf8\xccE\xc2\xf0*\x04\xfbB@\xe7\xf0"
    of_samples = b"$1$3$6$9$;$>$@CEHJMPRUWZ\\_adgilnqsvy{~\x80\x83"
    for seen in (of_a_figure, of_samples):
        assert Redactor.knowing((), home=None).redacted(seen, Grammar.TEXT) == seen


def test_bytes_of_a_figure_are_no_password_in_a_url():
    redactor = Redactor.knowing((), home=None)
    of_a_figure = b"\xbb\xcf\xef?pPw=\xf0\xa8\xfbq\x90\xd5\xaag'NP\xaf\x1e"
    assert redactor.redacted(of_a_figure) == of_a_figure
    for url in (b"http://cam/?pw=swordfish", "http://cam/?pw=séc".encode(), b"http://cam/?pw=abc"):
        for behind in (b"", b"\0\x90\x01", b" HTTP/1.1"):
            assert redactor.redacted(url + behind) == b"http://cam/?pw=REDACTED" + behind
    assert b"swordfish" not in redactor.redacted(b"http://cam/?pw=swordfish\x90\x01")


def test_a_log_may_be_cleaned_more_loosely_than_code():
    assert _clean("wifi password: hunter2\n") == "wifi password: REDACTED\n"
    assert _clean("password: str = ask()\n", loose=False) == "password: str = ask()\n"


def test_a_mere_word_that_a_sentence_begins_with_is_doubtful():
    text = "password: wanderlust opens the door\n"
    assert _clean(text) == text
    found = Redactor.knowing((), home=None).find(text.encode(), grammar_of(Path("log.txt")))
    assert [each.is_sure for each in found] == [False]


@pytest.mark.parametrize(
    ("code", "values"),
    [
        ('passwords = ["hunter2", "swordfish"]', ["hunter2", "swordfish"]),
        ('robot_password: dict = {"pi": "hunter2", "arm": input()}', ["hunter2"]),
        ('log_in(passwords=["hunter2"])', ["hunter2"]),
        ('SECRETS = ["LAB_TOKEN", "MQTT_PASS"]', []),
        ('credentials = {"user": "ada", "password": os.environ["LAB_PASS"]}', []),
        ('tokens = ["the", "robot"]', []),
    ],
)
def test_texts_that_a_secret_name_lists_are_doubtful(code, values):
    found = Redactor.knowing((), home=None).find(code.encode(), Grammar.CODE, is_file=True)
    assert [code[each.start + 1 : each.end - 1] for each in found] == values
    assert not any(each.is_sure for each in found)


@pytest.mark.parametrize(
    ("code", "cleaned"),
    [
        ('connect("host=db password=hunter2 dbname=runs")', 'connect("host=db password=REDACTED dbname=runs")'),
        ('connect(f"host={db} password=hunter2")', 'connect(f"host={db} password=REDACTED")'),
        ('smtp.login("ada@lab.example", "hunter2")', 'smtp.login("ada@lab.example", "REDACTED")'),
        ('contraseña = "hunter2"', 'contraseña = "REDACTED"'),
        ('connect(f"password={password} token=%s")', 'connect(f"password={password} token=%s")'),
        ("connect(password=password)", "connect(password=password)"),
        ('Y = """\nwifi:\n  psk: hunter2\n"""', 'Y = """\nwifi:\n  psk: REDACTED\n"""'),
        ('Y = """[mqtt]\npassword = hunter-two\n"""', 'Y = """[mqtt]\npassword = REDACTED\n"""'),
        (r'Y = "wifi:\n  pass: hunter2\n  port: 80"', r'Y = "wifi:\n  pass: REDACTED\n  port: 80"'),
        ("Y = 'wifi: 1\\n- token: hunter2'", "Y = 'wifi: 1\\n- token: REDACTED'"),
        ('print(f"password: {password}\\n token: %s")', 'print(f"password: {password}\\n token: %s")'),
        ('print("auth: failed")', 'print("auth: failed")'),
        ('def log_in(token):\n    """Log in.\n\n    token: base64-text\n    """', None),
    ],
)
def test_a_password_in_a_text_of_code_is_replaced_and_an_expression_stays(code, cleaned):
    redactor, chunks = Redactor.knowing((), home=None), [code.encode()]
    assert b"".join(redactor.cleaned(chunks, Hits(), Grammar.CODE)).decode() == (cleaned or code)


@pytest.mark.parametrize(
    "key",
    [
        "-----BEGIN OPENSSH PRIVATE KEY-----\nabc\ndef\n-----END OPENSSH PRIVATE KEY-----",
        "Encryption: none\nPrivate-Lines: 2\nabc\ndef\nPrivate-MAC: 0f",
    ],
)
def test_a_private_key_goes_whole_also_within_a_json_text(key):
    for text in (f"before\n{key}\nafter", key.replace("\n", "\\n"), key.replace("\n", "\\r\\n")):
        cleaned = _clean(text)
        assert "abc" not in cleaned
        assert "def" not in cleaned


def test_secrets_of_the_config_and_the_own_home_are_found_everywhere():
    home = Path("/srv/people/ada")
    assert _clean("joined with swordfish at /srv/people/ada/x", secrets={"swordfish"}, home=home) == (
        "joined with REDACTED at ~/x"
    )


def test_code_gives_its_secrets_away():
    code = """\
api_key: str = 'first-one'
settings = {'db_password': 'second-one', 'name': 'nobody'}
os.environ['TOKEN'] = 'third-one'
def connect(host, passphrase='fourth-one', *, secret=b'fifth-one'): ...
self.password = 'sixth-one'
tokenizer = 'not-this'
"""
    assert secrets_in_code(code) == {"first-one", "second-one", "third-one", "fourth-one", "fifth-one", "sixth-one"}
    assert secrets_in_code("this is (no code") == set()


def test_what_stands_in_the_place_of_a_missing_setting_is_one_and_what_is_said_of_a_setting_is_none():
    assert secrets_in_code('a = os.environ.get("DB_PASSWORD", "hunter2"); rospy.get_param(b)') == {"hunter2"}
    assert secrets_in_code('ask("password", "hunter2")') == set()


def cleaned_file(path, hits):
    with path.open("rb") as file:
        return b"".join(Redactor.knowing((), home=None).cleaned(chunks_of(file), hits, grammar_of(path)))


def test_a_secret_across_two_blocks_is_found(tmp_path):
    path = tmp_path / "log.txt"
    line = "x" * 99 + "\n"
    path.write_text(line * 10485 + "token=abcdefgh\n" + line * 20000, encoding="utf-8")  # at the end of the first MiB
    found: Counter[str] = Counter()
    cleaned = cleaned_file(path, Hits(replaced=found))
    assert b"abcdefgh" not in cleaned
    assert found == {"password": 1}
    assert len(cleaned) == path.stat().st_size


def test_a_key_across_two_blocks_is_found(tmp_path):
    path = tmp_path / "log.txt"
    begin, end = "-----BEGIN RSA PRIVATE KEY-----\n", "-----END RSA PRIVATE KEY-----\n"
    path.write_text("x" * 99 + "\n" + ("y" * 99 + "\n") * 10484 + begin + "MIIE\n" * 30 + end, encoding="utf-8")
    assert b"MIIE" not in cleaned_file(path, Hits())


def cleaned_table(text, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    redactor = Redactor.knowing((), home=None, replaces_doubtful=True)
    with path.open("rb") as file:
        return b"".join(redactor.cleaned(chunks_of(file), Hits(), grammar_of(path))).decode()


@pytest.mark.parametrize(
    "row", ['1,"it fell,\nand stood up",X', "1,ok; restarted,X", '1,"5"" pipe",X', '1,"5"x,X', '1,"5,X']
)
def test_a_secret_is_found_in_its_column_whatever_stands_in_the_others(row, tmp_path):
    table = f"run,note,password\n{row}\n2,ok,X\n"
    assert cleaned_table(table.replace("X", "hunter2"), tmp_path) == table.replace("X", "REDACTED")


@pytest.mark.parametrize(
    "table",
    [
        "run;energy;password\n1;1,5;X\n",
        'run,"note, by whom",password\r\n1,ok,X\r\n',
        'run\t"password"\n1;2\tX',
        'run,"note; by whom; when; where",password\n1,ok,X\n',
        'run,"note\nby whom",password\n1,ok,X\n',
    ],
)
def test_the_heading_says_what_separates_the_columns(table, tmp_path):
    assert cleaned_table(table.replace("X", "hunter2"), tmp_path) == table.replace("X", "REDACTED")


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(
    ("cell", "cleaned"),
    [
        ("https://lab.example/?api_key=hunter22", "https://lab.example/?api_key=REDACTED"),
        ("curl -u lab:hunter22", "curl -u lab:REDACTED"),
        ('{"password": "hunter22", "n": 5}', '{"password": "REDACTED", "n": 5}'),
        ('{"password": 12345678, "n": 5}', '{"password": REDACTED, "n": 5}'),
        ("password='hunter22'", "password='REDACTED'"),
        ("tcp://robot:7447", "tcp://robot:7447"),
        ("mqtt://lab:hunter22@broker", "mqtt://lab:REDACTED@broker"),
        ("a note on the password", "a note on the password"),
    ],
)
def test_what_is_replaced_in_a_cell_leaves_the_others_as_they_are(cell, cleaned, separator, tmp_path):
    def table(text):
        rows = [["Place", "Task", "Energy", "Host", "Note"], ["it's", text, "831.5", "pi@robot", "is Hunter22"]]
        written = io.StringIO()
        csv.writer(written, delimiter=separator, lineterminator="\n").writerows(rows)
        return written.getvalue()

    assert cleaned_table(table(cell), tmp_path) == table(cleaned)


def test_a_table_that_is_longer_than_a_block_keeps_its_secret_columns(tmp_path):
    table = "password,run\n" + f"X,{'7' * 1000}\n" * 4500  # a block is 4 MiB
    assert "hunter2" not in cleaned_table(table.replace("X", "hunter2"), tmp_path)


@pytest.mark.long
def test_a_table_that_is_longer_than_a_block_keeps_its_rows_together(tmp_path):
    note = "it fell, and stood up\n" * 1500
    table = "run,note,password\n" + f'1,"{note}",X\n' * 200  # blocks end within notes
    assert cleaned_table(table.replace("X", "hunter2"), tmp_path) == table.replace("X", "REDACTED")


@pytest.mark.long
def test_a_secret_over_rows_of_a_long_table_before_a_long_note_is_found(tmp_path):
    filled = "run,note,password\n" + f"2,{'7' * 1000},9\n" * 4100
    note = "it fell, and stood up\n" * 9000  # the first block of 4 MiB ends within it
    assert len(filled) < 4 << 20 < len(filled) + len(note)
    assert "hunter2" not in cleaned_table(f'{filled}password: |\n  hunter2\n  hunter2,"{note}",9\n', tmp_path)


@pytest.mark.long
def test_a_quote_that_nothing_closes_hides_no_secret_of_a_long_table(tmp_path):
    table = 'run,note,password\n1,"5,X\n' + f"2,{'7' * 1000},X\n" * 9000  # of several blocks
    assert cleaned_table(table.replace("X", "hunter2"), tmp_path) == table.replace("X", "REDACTED")


def test_bytes_that_are_no_text_are_told_from_text(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n", encoding="utf-8")
    (tmp_path / "b.dat").write_bytes(b"\0\1")
    (tmp_path / "c.parquet").write_text("PAR1", encoding="utf-8")
    assert [is_binary(tmp_path / name) for name in ("a.csv", "b.dat", "c.parquet")] == [False, True, True]
