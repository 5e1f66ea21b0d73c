"""The description of a run: the validator of Workflow Run RO-Crates finds everything it requires."""

import json
import socket

import pytest
from rocrate_validator import models, services


def is_online() -> bool:
    """Whether the contexts of JSON-LD, which the validator wants to read, can be had."""
    try:
        socket.create_connection(("w3id.org", 443), timeout=5).close()
    except OSError:
        return False
    return True


def test_a_run_folder_is_a_provenance_run_crate(survey):
    if not is_online():
        pytest.skip("the validator reads the contexts from w3id.org, which cannot be reached")
    settings = services.ValidationSettings(
        rocrate_uri=str(survey.folder),
        profile_identifier="provenance-run-crate-0.5",
        requirement_severity=models.Severity.REQUIRED,
        abort_on_first=False,
    )
    result = services.validate(settings)
    issues = [f"{issue.severity.name} {issue.check.identifier}: {issue.message}" for issue in result.get_issues()]
    assert not result.has_issues(), "\n".join(issues)


def test_every_action_has_its_tool_and_what_it_made(survey):
    described = json.loads((survey.folder / "ro-crate-metadata.json").read_text())
    entities = {entity["@id"]: entity for entity in described["@graph"]}
    actions = [entity for name, entity in entities.items() if name.startswith("#step-")]
    assert len(actions) == len(survey.manifest["steps"])
    for action in actions:
        assert entities[action["instrument"]["@id"]]["@type"] == "SoftwareApplication"
        results = action["result"] if isinstance(action["result"], list) else [action["result"]]
        assert results and all(result["@id"] in entities for result in results)
