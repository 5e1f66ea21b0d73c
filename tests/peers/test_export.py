"""Exported cameras: COLMAP reads what we write, and projects to the pixels of our formulas, for every lens it holds."""

import json
import subprocess
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from conftest import HERE, Run

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap cannot be imported", exc_type=ImportError)

PINHOLE = {"id": 0, "width": 1900, "height": 1601, "f": 4545.3, "cx": 956.8, "cy": 795.4}
LENSES = {
    "pinhole": {},
    "affine": {"b1": 2.25},
    "radial": {"k1": -0.081, "k2": 0.115},
    "brown": {"b1": -1.5, "k1": -0.081, "k2": 0.115, "p1": 3.1e-4, "p2": -1.7e-4},
    "full": {"b1": 0.75, "k1": -0.08, "k2": 0.11, "k3": -0.03, "p1": -2e-4, "p2": 4e-4},
}
POSES = [
    ("left-1.png", [0.039311536621218474, 0.9959108226630755, 0.0012083754339375246, 0.08133127454949464], [-2.9, -0.9, 20.0]),
    ("right.png", [0.03522935683002376, 0.9961608501693047, 0.00016995994397847621, -0.08014002820643681], [4.4, -0.75, 20.3]),
]


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    work = tmp_path_factory.mktemp("export")
    for name, lens in LENSES.items():
        images = [{"name": n, "sensor": 0, "q_wxyz": q, "C": c} for n, q, c in POSES]
        (work / f"{name}.json").write_text(json.dumps({"sensors": [PINHOLE | lens], "images": images}))
    command = [binary, "run", HERE / "export.yaml", "--quiet", "--store", work / "store", "--runs", work / "runs"]
    done = subprocess.run([*command, "--set", f"params.cameras={work}"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return Run((work / "runs" / "latest").resolve())


def rotation(q):
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def ours(lens, q, centre, points):
    """Pixels by our documented formulas, the centre of the first at (0, 0)."""
    s = PINHOLE | {"b1": 0, "k1": 0, "k2": 0, "k3": 0, "p1": 0, "p2": 0} | lens
    local = (points - np.array(centre)) @ rotation(q).T
    x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
    r2 = x * x + y * y
    radial = 1 + s["k1"] * r2 + s["k2"] * r2**2 + s["k3"] * r2**3
    xd = x * radial + 2 * s["p1"] * x * y + s["p2"] * (r2 + 2 * x * x)
    yd = y * radial + s["p1"] * (r2 + 2 * y * y) + 2 * s["p2"] * x * y
    return np.column_stack([s["cx"] + (s["f"] + s["b1"]) * xd, s["cy"] + s["f"] * yd])


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("model", ["text", "binary"])
def test_colmap_projects_to_our_pixels(run, lens, model):
    folder = run.output(model, "files", f"lens={lens}")
    reconstruction = pycolmap.Reconstruction(folder)
    points = np.random.default_rng(11).uniform([-3, -3, -1], [4, 3, 1], size=(500, 3))
    found = {image.name: image for image in reconstruction.images.values()}
    assert set(found) == {name for name, _, _ in POSES}
    for name, q, centre in POSES:
        image = found[name]
        camera = reconstruction.camera(image.camera_id)
        in_camera = image.cam_from_world() * points
        pixels = camera.img_from_cam(in_camera)
        np.testing.assert_allclose(pixels - 0.5, ours(LENSES[lens], q, centre, points), rtol=0, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_the_metashape_file_says_the_same_by_its_own_formulas(run, lens):
    root = ElementTree.parse(run.output("xml", "files", f"lens={lens}") / "cameras.xml").getroot()
    c = {e.tag: float(e.text) for e in root.find(".//calibration") if e.text and e.text.strip()}
    points = np.random.default_rng(12).uniform([-3, -3, -1], [4, 3, 1], size=(200, 3))
    for (name, q, centre), camera in zip(POSES, root.iter("camera"), strict=True):
        assert camera.get("label") == name
        m = np.array(camera.find("transform").text.split(), float).reshape(4, 4)
        local = (points - m[:3, 3]) @ m[:3, :3]
        x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
        r2 = x * x + y * y
        radial = 1 + c["k1"] * r2 + c["k2"] * r2**2 + c["k3"] * r2**3 + c["k4"] * r2**4
        xd = x * radial + c["p1"] * (r2 + 2 * x * x) + 2 * c["p2"] * x * y
        yd = y * radial + c["p2"] * (r2 + 2 * y * y) + 2 * c["p1"] * x * y
        u = PINHOLE["width"] / 2 + c["cx"] + xd * c["f"] + xd * c["b1"] + yd * c["b2"]
        v = PINHOLE["height"] / 2 + c["cy"] + yd * c["f"]
        np.testing.assert_allclose(np.column_stack([u, v]) - 0.5, ours(LENSES[lens], q, centre, points), rtol=0, atol=1e-9)
