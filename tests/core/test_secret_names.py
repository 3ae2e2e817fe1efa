"""A name tells whether what stands under it is a secret; a secret that was set is known again, and not kept."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robot_runner.core.secret_names import (
    REDACTED,
    hidden_settings,
    is_same_setting,
    is_secret_name,
    secrets_of_environment,
    sentences_without_secrets,
    shown_assignments,
    shown_settings,
    without_environment_secrets,
)

_OF_SECRETS = (
    "pw pass ssh_pass auth wifi_password apiKey PLUG_PW api_tokens wep_key0 client-key-data aws_secret_access_key psk "
    "PrivateKey AccountKey _authToken wifi_pin2 WACHTWOORD X-Api-Key ansible_ssh_pass secrets password2 "
    "contraseña CONTRASEÑA_WIFI senhaDoRobo"
)
_OF_OTHER_THINGS = (
    "author keyboard key compass bypass passed first_pass max_tokens tokens eos_token tokenizer password_file led_pin "
    "password_env token_count key_name pass_rate auth_method id-token SSH_AUTH_SOCKET_PATH encoder_pin"
)


@pytest.mark.parametrize(
    "name",
    _OF_SECRETS.split(),
)
def test_a_secret_is_kept_under_this_name(name):
    assert is_secret_name(name)


@pytest.mark.parametrize(
    "name",
    _OF_OTHER_THINGS.split(),
)
def test_this_name_tells_of_something_else(name):
    assert not is_secret_name(name)


def test_a_secret_setting_is_known_again_and_not_kept():
    settings = {"db_password": "swordfish", "robot": "simulated"}
    kept, again = (hidden_settings(settings)["db_password"] for _ in range(2))
    assert "swordfish" not in kept
    assert kept != again  # salted: who has two manifests does not see that the passwords are the same
    assert is_same_setting(kept, "swordfish")
    assert not is_same_setting(kept, "sword")
    assert not is_same_setting(kept, None)
    assert hidden_settings(settings)["robot"] == "simulated"
    assert is_same_setting("simulated", "simulated")
    assert shown_settings({"db_password": kept, "robot": "simulated"}) == {
        "db_password": REDACTED,
        "robot": "simulated",
    }
    assert shown_assignments(["pw=a=b", "robot=x"]) == ["pw=...", "robot=x"]


def test_values_of_variables_with_such_names_are_hidden(monkeypatch):
    monkeypatch.setenv("LAB_TOKEN", 'open "sesame"')
    monkeypatch.setenv("DEPLOY_KEY", "-----BEGIN-----\nMIIEpAIBAAKCAQEA7\n-----END-----")
    for name, harmless in {"XX_PASS": "true", "SSH_AUTH_SOCK": "/run/a.1", "OLDPWD": "/x y", "PW": "12345"}.items():
        monkeypatch.setenv(name, harmless)
    found = secrets_of_environment()
    assert 'open "sesame"' in found
    assert "MIIEpAIBAAKCAQEA7" in found
    assert not {"true", "/x y", "12345"} & set(found)
    assert without_environment_secrets('{"said": "open \\"sesame\\""}') == '{"said": "REDACTED"}'


def test_a_secret_is_hidden_from_the_moment_on_in_which_it_took_the_place_of_another(monkeypatch):
    monkeypatch.setattr("robot_runner.core.secret_names.time.monotonic", lambda: 1.0)
    for secret in ("open-sesame", "another-one"):
        monkeypatch.setenv("LAB_TOKEN", secret)
        assert without_environment_secrets(secret) == REDACTED


def test_of_a_record_what_was_said_shared_and_started_is_hidden_and_data_stay_as_they_are(monkeypatch):
    monkeypatch.setenv("LAB_TOKEN", 'open "sesame"')
    text = os.environ["LAB_TOKEN"]
    record = {
        "owner": text,
        "value": text,
        "combination": {"Task": text},
        "problem": f"refused: {text}",
        "values": {
            "address": f"mqtt://u:{text}@host",
            "all": [(text, 1.5, None, True)],
            "path": {text: Path(text)},
        },
        "command": ["planner", "--token", text],
        "environment": {"TOKEN": text},
        "condition": f"http://host/?token={text} answers",
    }
    assert sentences_without_secrets(record) == {
        "owner": text,
        "value": text,
        "combination": {"Task": text},
        "problem": "refused: REDACTED",
        "values": {
            "address": "mqtt://u:REDACTED@host",
            "all": [["REDACTED", 1.5, None, True]],
            "path": {"REDACTED": "REDACTED"},
        },
        "command": ["planner", "--token", "REDACTED"],
        "environment": {"TOKEN": "REDACTED"},
        "condition": "http://host/?token=REDACTED answers",
    }
