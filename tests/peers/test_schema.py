"""The JSON Schema for editors: the jsonschema library takes every pipeline, and refuses what the engine refuses."""

import json
import subprocess
from pathlib import Path

import jsonschema
import pytest
import yaml

PIPELINES = sorted((Path(__file__).resolve().parents[2] / "pipelines").glob("*.yaml"))

BAD = [
    "{rockface: 1, steps: {a: {stage: synthesise-fase}}}",
    "{rockface: 1, steps: {a: {stage: synthesise-face, wiht: {}}}}",
    "{rockface: 1, steps: {a: {stage: synthesise-face, with: {no_such: 1}}}}",
    "{rockface: 1, steps: {a: {stage: difference-dem, in: {reference: a.b}}}}",
    "{rockface: 1, axes: {a: {count: 3, items: [x]}}, steps: {a: {stage: synthesise-face}}}",
    "{rockface: 2, steps: {a: {stage: synthesise-face}}}",
]


@pytest.fixture(scope="module")
def schema(binary):
    printed = subprocess.run([binary, "stages", "--schema"], capture_output=True, check=True, timeout=60)
    found = json.loads(printed.stdout)
    jsonschema.Draft202012Validator.check_schema(found)
    return jsonschema.Draft202012Validator(found)


@pytest.mark.parametrize("path", PIPELINES, ids=lambda path: path.name)
def test_pipelines_fit(schema, path):
    schema.validate(yaml.safe_load(path.read_text()))


@pytest.mark.parametrize("text", BAD)
def test_faults_do_not(schema, text):
    assert not schema.is_valid(yaml.safe_load(text))
