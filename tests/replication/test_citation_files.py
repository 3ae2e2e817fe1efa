"""How to cite a package and under which terms to use it, in the formats that archives and reference managers read."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from importlib.resources import files

import pytest
import yaml
from jsonschema import Draft7Validator, FormatChecker

from robot_runner.replication.about import About, citation_text, licence_text, missing_text, zenodo_text

ABOUT = About(
    'naps: "short" ones',
    (
        {"name": "Ada King Lovelace", "affiliation": "Analytical: Engines", "orcid": "0000-0002-1825-0097"},
        {"name": "van Beethoven, Ludwig"},
        {"name": "Plato"},
    ),
    "CC-BY-4.0",
    "our paper, 10.1109/ICSE-Companion52605.2021.00029.",
    "2026-01-31T12:00:00Z",
)


@pytest.fixture(scope="module")
def schema():
    """Return the schema of the Citation File Format 1.2.0, which the package check-jsonschema brings."""
    found = files("check_jsonschema") / "builtin_schemas" / "vendor" / "citation-file-format.json"
    return Draft7Validator(json.loads(found.read_text(encoding="utf-8")), format_checker=FormatChecker())


@pytest.mark.parametrize("licence", ["CC-BY-4.0", "MIT", "GPL-3.0-or-later", None, "X-1.0", "https://example.org/l"])
@pytest.mark.parametrize("authors", [ABOUT.authors, ()])
def test_the_citation_is_valid_whatever_is_known(schema, licence, authors):
    about = replace(ABOUT, licence=licence, authors=authors)
    cited = yaml.safe_load(citation_text(about, "One sentence: all of it."))
    cited["date-released"] = str(cited["date-released"])
    assert [error.message for error in schema.iter_errors(cited)] == []
    assert cited["title"].endswith('naps: "short" ones')


def test_the_validator_of_citations_would_notice(schema):
    cited = yaml.safe_load(citation_text(ABOUT, "One sentence."))
    assert [error.message for error in schema.iter_errors({**cited, "authors": []})]


def test_names_are_cited_by_their_family_names():
    cited = yaml.safe_load(citation_text(ABOUT, "One sentence."))
    assert [each["family-names"] for each in cited["authors"]] == ["Lovelace", "van Beethoven", "Plato"]
    zenodo = json.loads(zenodo_text(ABOUT, "One sentence."))
    assert [each["name"] for each in zenodo["creators"]] == ["Lovelace, Ada King", "van Beethoven, Ludwig", "Plato"]
    assert zenodo["creators"][0]["orcid"] == "0000-0002-1825-0097"
    assert (zenodo["license"], zenodo["upload_type"]) == ("CC-BY-4.0", "dataset")
    assert zenodo["related_identifiers"][0]["identifier"] == "10.1109/ICSE-Companion52605.2021.00029"
    # Without a licence, who may see an upload is not decided for its authors.
    assert "access_right" not in json.loads(zenodo_text(replace(ABOUT, licence=None), "One sentence."))


@pytest.mark.parametrize(
    ("licence", "begins"),
    [
        ("MIT", "MIT License\n\nCopyright (c) 2026 Ada King Lovelace; van Beethoven, Ludwig; Plato\n"),
        ("Apache-2.0", "Apache License\nVersion 2.0"),
        ("BSD-3-Clause", "Copyright (c) 2026 Ada King"),
        ("CC-BY-4.0", "Creative Commons Attribution 4.0 International"),
        ("CC0-1.0", "Creative Commons"),
        ("GPL-3.0-only", "GNU GENERAL PUBLIC LICENSE\nVersion 3"),
        (None, "No licence was given: all rights are reserved"),
    ],
)
def test_the_text_of_a_licence_has_no_marks_of_its_template(licence, begins):
    text = licence_text(replace(ABOUT, licence=licence))
    assert text.startswith(begins)
    assert "<<" not in text
    assert ">>" not in text


def test_a_licence_that_is_misspelt_is_named_with_the_nearest():
    assert "or is it CC-BY-4.0?" in missing_text(replace(ABOUT, licence="CC-BY-4")).fix


@pytest.mark.long
def test_a_text_that_nobody_has_is_said_and_the_authors_own_is_taken(experiment, tmp_path, ada):
    import shutil

    from tests.replication.small_experiment import home

    from robot_runner.replication.packing import pack
    from robot_runner.replication.sealing import Packing

    copied = shutil.copytree(experiment, tmp_path / "small")
    asked = Packing(with_wheels=False, licence="X-Lab-1.0")
    with home(ada):
        packed = pack(copied, tmp_path / "a.zip", asked)
        assert "the text of X-Lab-1.0 is not in the package" in " ".join(each.problem for each in packed.findings)
        (copied / "LICENSE").write_text("Use it on Mondays.\n", encoding="utf-8")
        packed = pack(copied, tmp_path / "a.zip", asked)
    assert not [each for each in packed.findings if each.where == "licence"]
    with zipfile.ZipFile(packed.path) as archive:
        assert archive.read("LICENSE") == b"Use it on Mondays.\n"
        zenodo = json.loads(archive.read(".zenodo.json"))
    assert "license" not in zenodo  # it is none of those that archives know
