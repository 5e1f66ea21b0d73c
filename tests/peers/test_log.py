"""The log: the Python mcap library reads every message, and it agrees with the manifest of the run."""

import json

import pytest
from mcap.reader import NonSeekingReader, make_reader


@pytest.fixture(scope="module")
def log(survey):
    with (survey.folder / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return {
            "summary": reader.get_summary(),
            "messages": list(reader.iter_messages()),
            "attachments": list(reader.iter_attachments()),
            "metadata": list(reader.iter_metadata()),
        }


@pytest.fixture(scope="module")
def decoded(log):
    return [json.loads(message.data) for _, _, message in log["messages"]]


def test_topics_are_the_steps(log, survey):
    steps = {step["step"] for step in survey.manifest["steps"]}
    assert {channel.topic for _, channel, _ in log["messages"]} == {f"/{step}/step" for step in steps}
    assert {channel.message_encoding for _, channel, _ in log["messages"]} == {"json"}


def test_messages_agree_with_the_manifest(decoded, survey):
    shared = ["step", "point", "stage", "version", "key", "outputs"]
    assert [{name: message[name] for name in shared} for message in decoded] == [
        {name: step[name] for name in shared} for step in survey.manifest["steps"]
    ]
    assert any(len(message["entries"]) > 0 for message in decoded)


def test_messages_are_what_their_schema_says(log, decoded):
    kinds = {"string": str, "object": dict, "integer": int, "array": list}
    for (schema, channel, _), message in zip(log["messages"], decoded, strict=True):
        assert schema.encoding == "jsonschema"
        properties = json.loads(schema.data)["properties"]
        assert set(message) == set(properties), channel.topic
        for name, value in message.items():
            assert isinstance(value, kinds[properties[name]["type"]]), f"{channel.topic}: {name}"


def test_times_and_numbers_grow(log):
    times = [message.log_time for _, _, message in log["messages"]]
    assert times == [1_000_000 * (i + 1) for i in range(len(times))]
    statistics = log["summary"].statistics
    assert statistics.message_count == len(times)
    assert (statistics.message_start_time, statistics.message_end_time) == (times[0], times[-1])


def test_recipes_are_attached(log, survey):
    [attachment] = log["attachments"]
    assert (attachment.name, attachment.media_type) == ("recipes.json", "application/json")
    recipes = json.loads(attachment.data)
    steps = survey.manifest["steps"]
    assert [(r["stage"], r["version"], r["params"]) for r in recipes] == [
        (s["stage"], s["version"], s["parameters"]) for s in steps
    ]


def test_metadata_tells_of_the_run(log, survey):
    [metadata] = log["metadata"]
    assert metadata.name == "rockface"
    assert metadata.metadata["pipeline"] == survey.manifest["pipeline"]["text"]
    assert metadata.metadata["seed"] == str(survey.manifest["seed"])
    assert metadata.metadata["rockface"] == survey.manifest["program"]["rockface"]
    assert json.loads(metadata.metadata["overrides"]) == survey.manifest["overrides"]["set"]


def test_it_reads_as_a_stream_too(log, survey):
    with (survey.folder / "run.mcap").open("rb") as file:
        streamed = list(NonSeekingReader(file, validate_crcs=True).iter_messages())
    assert [message.data for *_, message in streamed] == [message.data for *_, message in log["messages"]]
