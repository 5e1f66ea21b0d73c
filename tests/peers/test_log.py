"""The log: the Python mcap library reads every message, Foxglove's own schemas decode it, and it agrees with the manifest."""

import io
import json
import struct
import zlib

import numpy as np
import pytest
import trimesh
from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    CompressedImage_pb2,
    FrameTransforms_pb2,
    Grid_pb2,
    Log_pb2,
    PointCloud_pb2,
    SceneUpdate_pb2,
)
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory
from readers import read_depth, unproject

FOXGLOVE = {
    f"foxglove.{next(iter(module.DESCRIPTOR.message_types_by_name))}": module
    for module in [
        CameraCalibration_pb2,
        CompressedImage_pb2,
        FrameTransforms_pb2,
        Grid_pb2,
        Log_pb2,
        PointCloud_pb2,
        SceneUpdate_pb2,
    ]
}


@pytest.fixture(scope="module")
def log(survey):
    with (survey.folder / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return {
            "summary": reader.get_summary(),
            "messages": list(reader.iter_messages()),
            "attachments": {attachment.name: attachment for attachment in reader.iter_attachments()},
            "metadata": list(reader.iter_metadata()),
        }


@pytest.fixture(scope="module")
def decoded(survey):
    """Topic, schema name, second and decoded message, of every message."""
    with (survey.folder / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory(), Json()])
        return [
            (channel.topic, schema.name, message.log_time // 10**9, value)
            for schema, channel, message, value in reader.iter_decoded_messages()
        ]


@pytest.fixture(scope="module")
def face(survey):
    return trimesh.load_mesh(survey.output("face", "mesh.ply"), process=False)


class Json:
    """Decodes messages with a JSON schema."""

    def decoder_for(self, encoding, _schema):
        return json.loads if encoding == "json" else None


def of_topic(decoded, topic):
    return [value for name, _, _, value in decoded if name == topic]


def steps_of(decoded):
    return [value for _, schema, _, value in decoded if schema == "rockface.Step"]


@pytest.mark.parametrize("of", ["survey", "quickstart"])
def test_every_message_is_decoded_by_the_schemas_of_foxglove(request, of):
    run = request.getfixturevalue(of)
    seen, count = set(), 0
    with (run.folder / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        expected = reader.get_summary().statistics.message_count
        for schema, channel, message in reader.iter_messages():
            count += 1
            if schema.encoding == "protobuf":
                assert channel.message_encoding == "protobuf"
                value = getattr(FOXGLOVE[schema.name], schema.name.removeprefix("foxglove."))()
                value.ParseFromString(message.data)
                # Nothing is left over that the published schema does not know.
                assert value.SerializeToString(deterministic=True) and not list(unknown(value)), channel.topic
                seen.add(schema.name)
            else:
                assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
                value = json.loads(message.data)
                assert set(value) == set(json.loads(schema.data)["properties"]), channel.topic
    assert seen == set(FOXGLOVE) and count == expected > 0


def unknown(message):
    """Numbers of fields the schema does not have, at any depth."""
    from google.protobuf import unknown_fields

    yield from (field.field_number for field in unknown_fields.UnknownFieldSet(message))
    for descriptor, value in message.ListFields():
        if descriptor.message_type is not None:
            for part in value if descriptor.is_repeated else [value]:
                yield from unknown(part)


def test_notes_agree_with_the_manifest(decoded, survey):
    shared = ["step", "point", "stage", "version", "key", "outputs"]
    notes = steps_of(decoded)
    assert [{name: note[name] for name in shared} for note in notes] == [
        {name: step[name] for name in shared} for step in survey.manifest["steps"]
    ]
    for note, step in zip(notes, survey.manifest["steps"], strict=True):
        for shown in note["shown"]:
            assert shown["of"]["digest"] == step["outputs"][shown["port"]]["digest"]
            assert (survey.folder / shown["of"]["path"]).is_file()
            assert shown["topics"]


def test_metrics_are_those_of_the_manifest(decoded, survey):
    told = {}
    for topic, schema, _, value in decoded:
        if schema == "rockface.Metrics":
            told[topic, json.dumps(value["point"])] = value
    compared = 0
    for step in survey.manifest["steps"]:
        for metric in step["metrics"]:
            value = told[f"/{step['step']}/metrics", json.dumps(step["point"])]
            assert value["values"][metric["name"]] == metric["value"]
            assert value["units"][metric["name"]] == metric["unit"]
            compared += 1
    assert compared > 10


def test_time_is_the_order_of_the_steps(log, decoded):
    times = [message.log_time for _, _, message in log["messages"]]
    assert times == sorted(times)
    assert times[0] == 10**9 and times[-1] == 10**9 * len(steps_of(decoded))
    assert {second for topic, _, second, _ in decoded if topic == "/matched/depth"} == {
        second for topic, _, second, _ in decoded if topic == "/matched/step"
    }
    statistics = log["summary"].statistics
    assert statistics.message_count == len(times)
    assert (statistics.message_start_time, statistics.message_end_time) == (times[0], times[-1])


def test_a_cloud_lies_on_its_depth_map(decoded, survey):
    [cloud] = of_topic(decoded, "/left/depth/cloud")
    assert [field.name for field in cloud.fields] == ["x", "y", "z"] and cloud.point_stride == 12
    origin = np.array([cloud.pose.position.x, cloud.pose.position.y, cloud.pose.position.z])
    points = np.frombuffer(cloud.data, "<f4").reshape(-1, 3) + origin
    assert 1000 < len(points) <= 10_000 and cloud.frame_id == "wall"
    channels, camera = read_depth(survey.output("left", "depth.exr"))
    rows, columns = np.nonzero(~np.isnan(channels["Z"]))
    everything = unproject(camera, columns, rows, channels["Z"][rows, columns])
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(everything).query(points)
    assert distance.max() < 1e-5


def test_a_camera_stands_where_its_depth_map_says(decoded, survey):
    [pose] = of_topic(decoded, "/left/depth/pose")
    [transform] = pose.transforms
    _, camera = read_depth(survey.output("left", "depth.exr"))
    assert (transform.parent_frame_id, transform.child_frame_id) == ("wall", "left.depth/left")
    w, x, y, z = camera["image"]["camera_from_object"]
    turn, place = transform.rotation, transform.translation
    # The camera in the wall frame: C, and the inverse of the rotation into the camera.
    assert (turn.w, turn.x, turn.y, turn.z) == (w, -x, -y, -z)
    assert [place.x, place.y, place.z] == camera["image"]["centre_m"]
    [calibration] = of_topic(decoded, "/left/depth/camera")
    sensor = camera["sensor"]
    assert (calibration.width, calibration.height) == (sensor["width_px"], sensor["height_px"])
    assert list(calibration.K) == [sensor["f"], 0, sensor["cx"], 0, sensor["f"], sensor["cy"], 0, 0, 1]
    assert calibration.distortion_model == "plumb_bob" and len(calibration.D) == 5


def test_a_mesh_is_its_own_or_a_thinned_one(decoded, face):
    [update] = of_topic(decoded, "/face/mesh")
    [entity] = update.entities
    [triangles] = entity.triangles
    assert 0 < len(triangles.indices) // 3 <= 20_000 and max(triangles.indices) < len(triangles.points)
    told = {pair.key: pair.value for pair in entity.metadata}
    assert len(told["blake3"]) == 64 and told["file"] == "outputs/face/mesh.ply"
    origin = triangles.pose.position
    points = np.array([[p.x + origin.x, p.y + origin.y, p.z + origin.z] for p in triangles.points])
    distance = np.abs(face.nearest.signed_distance(points[:: max(1, len(points) // 200)]))
    assert distance.max() < 0.05
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose([low, high], face.bounds, rtol=0, atol=0.1)


def test_a_grid_is_its_raster_upside_down(decoded, survey):
    import rasterio

    [grid] = of_topic(decoded, "/change/raster")
    with rasterio.open(survey.output("change", "raster.tif")) as raster:
        values, transform = raster.read(1), raster.transform
    columns, rows = grid.column_count, len(grid.data) // grid.row_stride
    assert grid.cell_size.x == pytest.approx(transform.a) and (rows, columns) == values.shape
    found = np.frombuffer(grid.data, "<f4").reshape(rows, columns)
    np.testing.assert_array_equal(found[::-1], values)
    assert grid.pose.position.x == pytest.approx(transform.c)
    assert grid.pose.position.y == pytest.approx(transform.f + rows * transform.e)


def palette_numbers(png):
    """Numbers and palette of an indexed PNG, by the PNG specification alone."""
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    at, data, chunks = 8, b"", {}
    while at < len(png):
        (length,) = struct.unpack(">I", png[at : at + 4])
        kind, body = png[at + 4 : at + 8], png[at + 8 : at + 8 + length]
        data, chunks[kind] = data + (body if kind == b"IDAT" else b""), body
        at += 12 + length
    width, height, depth, colour = struct.unpack(">IIBB", chunks[b"IHDR"][:10])
    assert (depth, colour) == (8, 3)
    rows = np.frombuffer(zlib.decompress(data), np.uint8).reshape(height, width + 1)
    out = np.zeros((height, width), np.uint8)
    for row in range(height):
        line, above = rows[row, 1:].astype(int), out[row - 1].astype(int) if row else np.zeros(width, int)
        for column in range(width):
            left = int(out[row, column - 1]) if column else 0
            corner = int(above[column - 1]) if column else 0
            near = {0: 0, 1: left, 2: above[column], 3: (left + above[column]) // 2}.get(rows[row, 0])
            if near is None:
                guess = left + above[column] - corner
                near = min((left, above[column], corner), key=lambda value: abs(guess - value))
            out[row, column] = (line[column] + near) & 255
    return out


def test_colours_of_a_picture_are_values(decoded, survey):
    note = next(note for note in steps_of(decoded) if note["step"] == "known")
    [shown] = [shown for shown in note["shown"] if shown["topics"] == ["/known/depth"]]
    key = shown["colours"]
    assert (key["quantity"], key["unit"], key["palette"]) == ("depth", "m", "viridis")
    [image] = of_topic(decoded, "/known/depth")
    numbers = palette_numbers(image.data)
    channels, _ = read_depth(survey.output("known", "depth.exr"))
    z = channels["Z"]
    assert image.format == "png" and numbers.shape == z.shape
    assert np.array_equal(numbers == 0, np.isnan(z))
    step = (key["high"] - key["low"]) / 254
    values = key["low"] + (numbers.astype(float) - 1) * step
    seen = ~np.isnan(z)
    assert np.abs(values - np.clip(z, key["low"], key["high"]))[seen].max() <= 0.5 * step + 1e-6


def test_what_was_run_is_attached(log, survey):
    recipes = json.loads(log["attachments"]["recipes.json"].data)
    steps = survey.manifest["steps"]
    assert [(r["stage"], r["version"], r["params"]) for r in recipes] == [
        (s["stage"], s["version"], s["parameters"]) for s in steps
    ]
    assert log["attachments"]["pipeline.yaml"].data.decode() == survey.manifest["pipeline"]["text"]


def test_metadata_tells_of_the_run(log, survey):
    [metadata] = log["metadata"]
    assert metadata.name == "rockface"
    assert metadata.metadata["pipeline"] == survey.manifest["pipeline"]["text"]
    assert metadata.metadata["seed"] == str(survey.manifest["seed"])
    assert metadata.metadata["rockface"] == survey.manifest["program"]["rockface"]
    assert json.loads(metadata.metadata["overrides"]) == survey.manifest["overrides"]["set"]


def test_it_reads_as_a_stream_too(log, survey):
    streamed = NonSeekingReader(io.BytesIO((survey.folder / "run.mcap").read_bytes()), validate_crcs=True)
    assert [message.data for *_, message in streamed.iter_messages()] == [m.data for *_, m in log["messages"]]


def test_the_layout_shows_topics_there_are(survey, decoded):
    layout = json.loads((survey.folder / "foxglove-layout.json").read_text())
    topics = {topic for topic, *_ in decoded}
    panels = layout["configById"]
    assert set(panels["3D!scene"]["topics"]) <= topics
    assert panels["Image!last"]["imageMode"]["imageTopic"] in topics
    assert all(path["value"].split(".")[0] in topics for path in panels["Plot!numbers"]["paths"])
