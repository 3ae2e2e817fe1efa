"""Authors, licence and citation are parts of a config, checked like all others."""

from __future__ import annotations

import pytest

from robot_runner.core.config.authors import Author, authors_from_text, is_licence
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import ConfigError


@pytest.mark.parametrize(
    "orcid", ["0000-0002-1825-0097", "https://orcid.org/0000-0001-5109-3700", "0000-0002-1694-233X"]
)
def test_an_orcid_is_kept_as_its_digits(orcid):
    assert Author("Ada", orcid=orcid).orcid == orcid[-19:]


@pytest.mark.parametrize("orcid", ["0000-0002-1825-0098", "0000000218250097", "ada", 7])
def test_an_orcid_with_a_wrong_digit_is_refused(orcid):
    with pytest.raises(ConfigError, match="not an ORCID"):
        Author("Ada", orcid=orcid)


def test_everything_that_is_wrong_with_an_author_is_said_at_once():
    with pytest.raises(ConfigError) as refused:
        Author(" ", orcid="7", affiliation="", affiliation_url="vu.nl")
    assert len(refused.value.findings) == 4


def test_authors_are_read_from_the_command_line():
    ada, josiah = authors_from_text(
        "Ada Lovelace; Analytical Society; https://example.org | Josiah; 0000-0002-1825-0097"
    )
    assert (ada.name, ada.affiliation, ada.affiliation_url, ada.orcid) == (
        "Ada Lovelace",
        "Analytical Society",
        "https://example.org",
        None,
    )
    assert (josiah.name, josiah.orcid) == ("Josiah", "0000-0002-1825-0097")


@pytest.mark.parametrize("orcid", ["0000-0002-1825-009", "0000-0002-9079-593x", "http://orcid.org/0000-0002-1825-009"])
def test_an_orcid_that_is_none_is_not_taken_for_an_affiliation(orcid):
    with pytest.raises(ConfigError, match="is not an ORCID"):
        authors_from_text(f"Josiah Carberry; {orcid}; Brown University")


def test_a_licence_is_an_identifier_or_a_page():
    assert is_licence("CC-BY-4.0")
    assert is_licence("https://example.org/terms")
    assert not is_licence("do what you want")


def test_a_config_names_its_authors_by_name_alone_or_in_full(write_config):
    path = write_config(
        """
        authors = ["Ada Lovelace"]
        licence = "MIT"
        citation = "Ask Ada."
        """
    )
    parameters = prepare(path, {"authors": "Ada; 0000-0002-1825-0097"}).experiment.parameters
    assert parameters.authors == (Author("Ada", orcid="0000-0002-1825-0097"),)
    assert (parameters.licence, parameters.citation) == ("MIT", "Ask Ada.")
    assert prepare(path).experiment.parameters.authors == (Author("Ada Lovelace"),)


@pytest.mark.parametrize(
    ("line", "where"),
    [
        ("authors = 'Ada'", "authors"),
        ("authors = [7]", "authors"),
        ("licence = 'my own'", "licence"),
        ("citation = ''", "citation"),
    ],
)
def test_what_cannot_be_is_refused(write_config, line, where):
    preparation = prepare(write_config(line))
    assert preparation.experiment is None
    assert preparation.findings[0].where.endswith(where)


def test_a_class_that_adds_to_authors_may_have_attributes_of_its_own() -> None:
    class Student(Author):
        __slots__ = ("number",)

    assert Student("Josiah Carberry", affiliation="Brown University").affiliation == "Brown University"
